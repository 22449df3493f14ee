"""The pages of the manual on runs, evidence, archives, fits, JSON, precision, and words.

The guide's pages on runs and their files, on how a march finds events and contacts, on evidence, and on many runs.

The page `xdynamics help archives`: runs in files, by time and many together, with xarray alone where that is enough.

The guide's page on fits.

The page `xdynamics help json`: what is in the JSON that verbs print.

The page `xdynamics help precision`: runs whose numbers have 31 digits.

The page `xdynamics help words`: names of records and of evidence that do not explain themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from xdynamics.documenting.model_pages import wrapped_lines
from xdynamics.evidence.refining.convergence import MEANINGS

ARCHIVES_PAGE = """\
An archive is a netCDF-4 file, which any program for netCDF reads: xr.open_dataset("run.nc"),
ncdump, Panoply, MATLAB.
  xd.open_run("run.nc")             verifies digests and seal, then opens it; xdynamics show run.nc
                                    prints what it holds
  xd.verify("run.nc")               verdict and digest. verified: every byte is as it was written.
                                    repacked: written by another program (nccopy, ncks, to_netcdf,
                                    h5netcdf, Zarr and back), and every number, name, dimension,
                                    type and unit agrees; history, comment and other notes are free.
                                    edited: sound, but not what was archived; open_run warns, save
                                    takes it with derived= alone. damaged: refused
  xd.save(run, "run.nc")            as it was marched, or a part of it; what was edited with
                                    derived="how it was made"
  xd.save(run, "run.nc", creator="A. B.", license="CC-BY-4.0")   also institution, id, references,
                                    comment: notes, outside of the digests; a model's [about] has
                                    them for all its runs
  run.load(), run[["y", "v_y"]]     as of every Dataset of xarray; arrays of a run are read-only
What describes a run (parameters, times, step_number, the texts model_toml and force_source along
the dimension document, of size 1) are coordinates, what it yields is data: run.mean("step"), run*2,
run.where(…), groupby and concat meet numbers alone. run.model_toml.item() is the text.
  run.isel(step=slice(10, None))    a selection. event_row_before, event_row_after, trial_step and
                                    sample_step name rows by step_number, their number in the whole
                                    run, so that run.dynamics.events("floor") finds the states
  run.dynamics.table("events")      a table for pandas with units in its headers, `y [m]`: steps,
                                    trials, events, samples, closed, parameters; of evidence levels,
                                    cases, terms, times, members. `xdynamics table` writes it as
                                    .csv, .md, .tex, and with xdynamics[tables] as .xlsx (of 16
                                    digits) and .parquet. run.dynamics.frame("event") has the names
                                    of the record
  budget.sel(term="vt")             names are labels in memory: sel(parameter="k") of a fit,
                                    sel(run="rk4") of a comparison, run.dynamics.events().sel(
                                    event="apex"); of what has common times, .sel(at_time=1.0) or
                                    .dynamics.at("1 s")
  run.dynamics.tree()               plain tables: /steps, /trials, /events with both one-sided
                                    states, /samples; xr.open_datatree("run.nc", engine="xdynamics")
  xr.open_dataset("run.nc", engine="xdynamics", group="events")   one of them
  xr.concat([a, b], "member", coords="different", compat="equals")   runs with as many rows
By time. Rows are accepted steps, wherever those ended, and at an event there are two at one time,
before and after it.
  run.dynamics.at("1 s")            states at any time, each as if a step had ended there: numbers;
                                    along `at` of [0.1, 0.2] or "0:2:201 s"
  run.sel(time=slice(0.5, 1.0))     the rows from 0.5 s to 1 s
  run.sel(time=1.0)                 rows that end there exactly, two at an event; a KeyError
                                    `not all values found in index 'time'` says that no step ended
                                    there: run.dynamics.at("1 s")
  run.sel(time=…, method="nearest") is refused by xarray,
                                    `Reindexing only valid with uniquely valued Index objects`,
                                    where a time has two rows; run.interp(time=…) too, since rows
                                    are along step. A straight line between rows would be neither
                                    the method's state nor leave out jumps: run.dynamics.at repeats
                                    the step
  Below such an error, and below those of resample, rolling, coarsen and drop_sel, stands a note of
  ours that names run.dynamics.at with the times that were asked for. reindex(time=…), reindex_like
  and interp_like are refused: xarray would give the rows as they were, without a word.
  time has no index: with one, xarray aligns records by it and refuses a.y - b.y and
  xr.concat([a, b], "run") of runs that have equally many rows at other times.
Pictures. xarray draws against rows; name the time:
  run.y.plot(x="time"), run.y.hvplot(x="time"), hv.Curve((run.time, run.y))
  xarray keeps attributes through arithmetic: (run.y/1000).plot(x="time") is still labelled m. Units
  are right by run.pint.quantify() (pint-xarray), or .assign_attrs(units="km"). Our own verbs
  compare with what was marched: run.assign(y=run.y/1000) is refused by plot, sample and diagnose,
  and in a summary, frame, events or a tree what was edited has the units `unknown unit`.
What xarray refuses of a run, and what to write:
  run.max(), run.min()              `zero-size array to reduction operation maximum which has no
                                    identity`, where no trial was rejected: run.max("step")
  run.resample(time="1s")           `Only valid with DatetimeIndex, TimedeltaIndex or PeriodIndex`:
                                    run.dynamics.at("0:2:21 s")
  xr.merge([a, b])                  `cannot reindex or align along dimension 'step'`, of runs with
                                    other rows: xd.compare(a, b), or both sampled at common times
  run.to_dataframe()                a row for each combination of all dimensions:
                                    run.dynamics.frame("event"), run.y.to_dataframe(), or a node of
                                    run.dynamics.tree()
Many files. Runs with as many rows, events and force evaluations are put together by xarray alone,
as are catalogues of sweeps that keep quantities at times:
  nested = dict(engine="xdynamics", combine="nested", concat_dim="run", coords="different",
                compat="equals")
  xr.open_mfdataset("runs/*.nc", **nested)
  xr.open_mfdataset(["a/catalogue.nc", "b/catalogue.nc"], **nested)
Without the engine xarray fails at texts that differ, `Can not use auto rechunking with object
dtype`; without coords and compat it may keep one parameter for all.
Others have rows of their own, `AlignmentError: cannot reindex or align along dimension 'step'`: put
them on common times,
  xr.open_mfdataset("runs/*.nc", preprocess=lambda run: xd.sample(run, "0:2:201 s"), **nested)
or keep them in a sweep, whose runs are read when they are used, along its axes:
  found = xd.sweep(model, {"g": "9:10:11 m s-2"}, keep=["log"], path="grid")   (or sweep --keep log)
  xd.open_logs("grid", "0:2:201 s")
Names of variables: `xdynamics help record`; words of evidence: `xdynamics help words`; buckets:
`xdynamics help stores`.
"""


FITS_PAGE = """\
A fit finds parameters and starts from measured data, with their uncertainties:
xd.fit(model, data, ["k", "x"]), or
  xdynamics fit spring.toml bench.csv --parameter k --parameter x -o F.nc --model fitted.toml
Data are a table of quantities of the model along a time: time [ms],x [mm],u(x) [mm]
(`xdynamics help files`), or of event times: one row is an occurrence, from the first on, or the one
that a column occurrence [1] says. The sound of a ball that bounces, of a model with
[contacts.floor] restitution = "e", gives its restitution:
  event_time_floor [s],u(event_time_floor) [s]
  0.4516,0.0002
  1.1913,0.0002
  xdynamics fit ball.toml clicks.csv --parameter e --parameter y --until "5 s"
Where the clock of a recording does not begin with the run, `offset` is what it reads at the model's
time 0, and is found too, for event times and for values alike. All readings have to lie inside the
run: leave out those from before it (the key skip), and end it later than the last by until. A
motion that repeats itself fits once in each period: bounds choose one.
  xdynamics fit ball.toml clicks.csv --parameter e --parameter offset --until "5 s"
  xdynamics fit spring.toml bench.csv --parameter k --parameter offset --until "12 s"
Several records are fitted at once, of which each may have an offset of its own (--own offset). All
share `parameters`; of `own` each has a value for itself:
  xdynamics fit spring.toml monday.csv tuesday.csv --parameter k --own x
models that differ in what is known are named as their records are:
  xd.fit({"light": one, "heavy": other}, {"light": "a.csv", "heavy": "b.csv"}, ["k"])
With u(...) in the data, chi-square says whether model and uncertainties fit. Without, the variance
follows from the residuals, and intervals are Student's t; one number of under 30 degrees of freedom
is so in the fitted model, too.
  --loss soft_l1 | huber | cauchy    outliers move the estimates no more than good values do, and
                                     are marked (outlier_x)
  --intervals profile                ends where the sum of squares has risen enough, with all other
                                     numbers fitted again: for laws that are not linear in a number
                                     over its uncertainty
  --bounds k='0:10 N m-1'            estimates on a bound are said to be there
  --coverage 0.95                    probability of the intervals
The fitted model has its numbers' uncertainties and correlations: budget, certify and sweep take it
as any other.
"""


JSON_PAGE = """\
With --json standard output holds one JSON object in one line and nothing else; warnings and errors
go to standard error, and exit codes stay. These have it: run, extend, complete, show, check,
sample, table, sweep, fit, budget, certify, recheck, refine, compare, diagnose, validate, verify,
reproduce, enclose, methods, modes.
  xdynamics fit pendulum.toml bench.csv --parameter L --json | jq '.variables.estimate.values'
  xdynamics show fit.nc --json | jq '.variables | [.parameter_name.values, .estimate.values]'
  xdynamics budget ball.toml --quantity y --at "1 s" --json | jq -r '.variables.result.values'
Numbers have all their digits: reading them gives the same bits. JSON has none that are not finite:
  nan is null, infinity is the text "inf" or "-inf"
Every object has
  kind        what it is: run, model, verification, reproduction, states, table, methods, method,
              part (of a run), or the kind of evidence, as of `show`
  title       in words; verifications and methods have none
  archive     the file that was written, if one was; model is the fitted model that `fit` wrote
Evidence (fit, budget, certificate, refinement, comparison, diagnosis, ledger, sweep …), and what
`sample` gives, as in archives:
  sizes       number of entries along each dimension
  attributes  settings, digests, versions: texts and numbers
  variables   by name, each with
    dims      names of its dimensions, none for a single number
    units     in UDUNITS spelling, "1" for a pure number or a text
    long_name what it is, if that is said
    values    a number or text, else lists in lists in the order of dims; a flag by its words, like
              "passed"
A table:
  units       of each column
  rows        list of rows, each by the names of the columns
A run:
  outcome, text, method, force_evaluations, sizes, content_digest
  end         time and state at the end; units has the unit of each, time is in s
  events      list of name, kind, time, uncertainty (of the location)
  parameters  as variables above, with uncertainty where the model gives one
A model (check):
  digest, counts (of its parts), equations (lines)
  parameters, initial   by name: value, units, and of parameters uncertainty in that unit, 0 if none
                        is known
  methods     by name: order, chooses_steps, refuses (list of reasons, empty if the method takes the
              model)
  scales      the linearisation at the start, as evidence above: frequency, period,
              largest_stable_step …; or unknown, why not
A reproduction has these too; attributes.identical is 1 where every bit is the same.
Methods: methods, by name; a single one has these itself:
  order, evaluations in an evaluations_in (step | iteration), estimate_order (null: by step
  doubling), interpolation_order
  is (list of plain, symplectic, symmetric, implicit), refuses, synonyms (lists), equations,
  reference
  oscillation_limit, decay_limit   largest w*h and h/tau of a stable step; null where the method
                                   takes no such forces
A verification:
  archives    list of archive, verdict (verified | repacked | edited | damaged | not verified),
              digest of the first two, text
"""


RUNS_PAGE = """\
A run is one Dataset, and one netCDF file: `xdynamics help record` lists what is in it,
`xdynamics show RUN.nc` says it. Attributes say what was used: method, equations, steps, tolerances,
precision, outcome in words with t and h, digests. Units are in UDUNITS spelling; archives pass the
CF-1.11 checker.
Writing  A file is written whole or not at all, carries a digest of every variable and a seal over
  its bytes, and is checked when it is opened: what is damaged, cut off or added is named. One that
  this process has not seen is first read by a process of its own, with bounded time and memory. A
  run that ends badly, or is stopped by Ctrl-C, does not replace an archive of one that ended well:
  it stands beside it, as run.partial.nc.
Editing  What is saved is what was marched. The arrays of a run are read-only; an edited record is
  refused, or saved as derived data, xd.save(run, file, derived="y scaled by 1.1"); a part of a run
  (isel, drop_vars) is a selection, found again by reproduce.
Going on  A run that lasts keeps what is finished of it every 10 s, in verified segments beside its
  archive. After a kill, a full disk or Ctrl-C the same command with --resume, or simulate(...,
  path=..., resume=True), goes on from there to the bits of the uninterrupted run;
  `xdynamics discard` removes them instead. `extend` continues a complete run beyond its end.
Thinning  --keep-every 1000 keeps a row in so many, --log states or x,y some columns; `complete`
  adds the rest; --compress packs. Of u[3],u[-1] the record has these alone: u(step, logged_site),
  run.u.sel(logged_site=3); dimensions of the model keep their size for all else.
Signing  Whoever edits a file on purpose can make a new seal, but no new signature: `sign` writes
  RUN.nc.sig (Ed25519, needs xdynamics[sign]), of every byte; `verify` says which it checked.
Same bits  A run has the same bits with any C library and with or without wide vectors or fused
  operations: nothing is contracted or reordered, and the elementary functions are made of + - * /
  and square roots, at most 1 ulp off.
Exit codes: 0 done, 1 ended badly, 2 wrong input, 143 ended by SIGTERM (as by Ctrl-C: what was
marched is kept). --quiet prints nothing, --json numbers (`xdynamics help json`). Verbs and options
are completed by the shell after
  eval "$(_XDYNAMICS_COMPLETE=bash_source xdynamics)"
The first run of an installation compiles the engine, once for all models (12 s of a free processor;
events and contacts 15 and 10 s more, when first needed), and can be interrupted; a wheel carries
it. Machine code is kept in ~/.cache/xdynamics, or in $XDYNAMICS_CACHE.
"""
MARCHING_PAGE = """\
Steps  Fixed (--step), or chosen so that every component's estimated error stays below atol +
  rtol*|value| (--rtol, --atol). The estimate is that of an embedded formula, or by step doubling
  for any method. Without an atol it is rtol times the variable's largest value so far, and never
  less than what rounding of terms that cancel makes of a step, the forces of contacts, friction and
  constraints among them, so that what rests ends no run (atol_floor_rule; atol_floor = none for an
  older archive, and in models whose forces have more than some three thousand operations).
  Rejected trials are rows with their reason. What speaks against a run is said in its outcome:
  uncontrolled variables, steps beyond the stability limit, stiffness, a nearly singular mass.
Events  An event may record, stop, set the state anew, or switch to another regime, in which other
  forces act. Every zero of an event function within a step is found, not its change of sign from
  end to end: the step is cut until intervals of the function and its slope, rounded outward, tell
  that a piece has no zero or just one. Two crossings in a step, a touch, a jump, a pole and what
  cannot be told apart are kinds of their own. Where a sign changes the march lands, by shortened
  steps of its own method; events at one instant are one group, with the states on both sides.
  A stop, switch or reset whose function is zero at the start, or where another event has acted, has
  happened if the motion takes it on in its direction, rising or falling (solver_event_start);
  without a direction leaving zero is no passage. Events that lead back to the state or regime that
  they began from at one instant, or act ever faster, end the run as sliding_mode or
  event_accumulation, with the accumulation_time: write what rests or bounces as [contacts], what
  rubs as [frictions], and let a controller switch back a little apart.
Switches  The zeros of arguments of abs, sign, min, max, where, in forces, rates, masses and
  friction, and the points of a table over x, are events too; of a force with smooth = true they
  are counted, and `refine` adds what that costs.
  The march lands on breakpoints of tables over time.
Contacts  Where a gap closes there is an impact: velocities change along the gap's gradient in the
  metric of the mass, by a coefficient of restitution that may depend on approach_speed, with
  Coulomb's friction. Contacts that touch at once are one complementarity problem, by the law that
  the model names: newton, poisson, sequential, energetic. A contact that stays has a normal force,
  solved together with the accelerations, and ends where it would pull. All that is located and
  recorded as impact, rest, takeoff, stick, slip, with impulses and the energy they took. A row in
  which a contact pulls, or friction holds too much, would end the run as contact_violated;
  `xdynamics verify --audit run.nc` looks for such rows, and for events that were missed. Bounces
  that shrink end at a time that is extrapolated. A state without an answer, or with two (Painleve),
  is an outcome and no guess.
  A force or a grip that fails for a part of a step is found there; between many bodies by looking
  at the middle of each step, and where a parabola says so.
  A heap of many bodies that rub comes to rest by ever more slips, lifts and impacts, each lower
  than the last. A slip that an impact began stops with it, between many bodies, where its friction
  would end it before it has gone as far, or lasted as long, as a bounce of rest_height. Its
  impulse, with what forces give in that time, lies within the cones of friction, else the slip
  goes on, as do slips that speed up or whose brake is weaker. Rows of rest and stick say what
  theirs took, in event_energy_lost, the summary what all did.
  Heaps of fifty bodies that rub, and more: method = moreau_jean. Other methods locate each impact,
  lift and slip, ever more as such a heap comes to rest, and may never reach it. It locates
  nothing: over each step a contact that is closed in its middle has one impulse, by Newton's law
  with friction, and bodies overlap by what they approach in a step. Its force in a row is the
  mean over the step before it, and acts all through the step in states that are sampled there;
  closed_force_residual is the residual of the equations for all impulses, at most 1e-6 of rates.
Implicit methods solve given steps until corrections are below solver_newton_tolerance of their
  unknowns, or, where large forces cancel, of what rounding of the state does to these.
The series of taylor end at a root of zero, such as the speed of a body at rest in a drag of
  v_x*hypot(v_x, v_y): chosen steps are short there, a given one from there errs by h**3.
Limits  Contacts have 24 forces at most, if they are not of a dimension or a relation; law =
  energetic is for one link at a time. They read no drives, and do not go with Python forces nor,
  but by differences, with implicit methods. Where a measured drive jumps, the row at the node holds
  the force before it. Lanes are for explicit methods and taylor.
Keys: `xdynamics help events`, `help contacts`, `help frictions`, `help run`; methods:
`xdynamics methods`.
"""
EVIDENCE_PAGE = """\
Stages take runs and models, and return Datasets with units and the digests of the runs that they
rest on.
  refine       over steps, tolerances, root tolerances or rules: differences, signed orders,
               verdicts, limits, uncertainties of states, events, periods; a gate where
               interpolation is larger than what is compared; until a change is small enough
  companion    the error that a run has come to since its start, by one more run at a tighter
               setting
  diagnose     energy and momentum, band and drift apart; cycles, phase, area; extremes and how they
               were found; residuals against closed forms; Lyapunov exponents with uncertainties;
               until when a run can be believed; whether steps, recomputed, lead to the next rows:
               continuity_verdict, _time, _steps, continuity_defect_y, continuity_bound_y
  modes        in Python, xd.modes(model) or of a row of a run: frequencies, shapes, eigenvalues,
               and the step to begin with by each method; saved and shown as others are
  compare      two runs at any times, beside the interpolation error, and what differs by value; or
               a run and measured data
  validate     every method against 34 closed forms and the laws of impact, with derived bounds; or
               a model against the law of its contacts and its own [validation.x]; of over 100
               elements of a quantity one line, with case_worst_element, case_elements_failed; the
               parts of a bound for rounding of expressions: bound_closed_form, bound_start
  enclose      proven bounds of every motion, for all starts and parameters within their half_width,
               through tables over time, switches and resets (`xdynamics help enclose`)
  error_budget of one number, at a time or an event, or of the largest load of a run: truncation,
               rounding, interpolation, event location, and every input that has an uncertainty,
               with slope and share; by draws their distributions (JCGM 101), and whether the linear
               budget is adequate; on the command line `budget`
  fit          parameters and starts from measured data, with covariance and tests of the residuals
               (`xdynamics help fits`)
  certify      a number with gates it has to pass; recheck makes it again from the file alone;
               bundle puts it with run, ledger and figures in a folder (RO-Crate, needs
               xdynamics[report]), of which report (xd.document) makes one page to hand out
  manufactured the force that makes a wanted trajectory exact
  limiting     one parameter moved to its limit
  xd.report    the last stage of a script: archives, figures and one page in a folder
Uncertainties stand in the model: vt = { value = "30 m s-1", uncertainty = 1 }, or half_width = 1
with distribution = "normal", "rectangular", "triangular", "arcsine" or "t", starts alike;
[correlations] m = { c = 0.3 }; a table's columns u(pull) [N], u_common(pull) [N]; [discrepancy]
y = "1 mm". Words: `xdynamics help words`.
With compute=False a stage, sample too, is described at once, dask arrays behind, and nothing is
marched; the first number computed marches each level once, dask.compute of several studies what
they share once (events need occurrences=10). 256 MB of results are remembered in a process, or
XDYNAMICS_REMEMBERED_LIMIT. Studies and budgets march without samples of the forces, and so share a
march with simulate where that has force_samples="none": samples are a part of the record, and of
its digest.
"""
GRIDS_PAGE = """\
A sweep is a lazy Dataset on its axes' own dimensions, computed by dask's threads or on a cluster
(`xdynamics help cluster`):
  grid = xd.sweep(model, {"vt": "20:60:41 m s-1", "method": ["heun", "dop853"]}, rtol=1e-8,
                  keep=["end", "event_time_ground"])
  xdynamics sweep data/models/ball_drag.toml --axis "vt=20:60:9 m s-1" \\
      --axis method=heun,dop853 --rtol 1e-8 -o balls
Axes are parameters, starts, methods, steps, tolerances, tables; in products, together ({"body":
{"m": [...], "c": [...]}}) or drawn (xd.Draws). Runs go side by side in vector code, one a lane,
with steps and events of their own. One after the other go models with contacts or frictions of many
elements, attitudes, controllers, periodic events, delays, forces in Python or events that read
tables, runs of 31 digits, by moreau_jean or an implicit method (but radau_iia of few variables),
and wide ones (over 2,048 numbers a row). Either way every member has the bits that it has alone
(check=0.01 looks). With path= it goes into a folder, on from where it was stopped; open_sweep opens
it; keep=["log"] keeps each run, and open_logs opens all.
xd.member(grid, vt="30 m s-1", method="dop853") is one member's whole run. Dimensions are called as
in a record: grid.sel(vt=30.0, solver_method="dop853"); where a parameter bears a word of xarray's
own, grid.sel({"method": 1.0}).
keep takes any number of a run, an event or a diagnosis: "energy_drift", "event_residual_ground".
Files may be objects, "s3://bucket/run.nc", a grid a Zarr store: `xdynamics help stores`. contrast,
sensitivities, influences, sobol_indices, convergence and precision say what a grid shows: contrast
and convergence with what each number is uncertain by, precision(model, {"method": [...], "rtol":
[...]}) with the Pareto front of work and error. xd.error_budget(grid, "t", event="ground") is the
budget of every member. Grids of several tolerances are put together by xarray itself,
xr.concat([one, other], "solver_rtol"), and are a grid. xd.open_runs("folder", keep=["end"]) makes
one of archived runs, along `member`, lazily; `xdynamics table folder/*.nc --keep energy_drift` is
its table.
xd.compare(grid, other), or `xdynamics compare balls others`, compares two, member by member, found
by the values of their axes: each difference with its uncertainty (from an axis of steps or
tolerances), whether it differs by more, who is alone, and the cause by name. Of a
section, an event that a motion meets once in a period, keep=["after_section_x"], occurrences=160
keeps each meeting: xd.plot(grid, transient=100), or plot --transient 100, is the bifurcation
diagram without the first hundred; transient="200 s" needs event_time_section kept, too.
"""
STORES_PAGE = """\
Whatever takes the name of a file or folder also takes that of an object: s3://bucket/runs/one.nc.
It needs
  pip install 'xdynamics[s3]'
and credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or in
~/.aws, never in the name; AWS_ENDPOINT_URL names a store that is not Amazon's.
  xdynamics run pendulum.toml -o s3://bucket/run.nc   (--resume goes on from segments beside it)
  xdynamics sweep pendulum.toml --axis 'g=1:10:99 m s-2' -o s3://bucket/grid
  xd.save(run, 's3://bucket/run.nc'); xd.open_run('s3://bucket/run.nc')
  xd.report('s3://bucket/page', run=run)
  xd.sweep(model, axes, path='grid.zarr')
      a Zarr store, of files or objects, for grids too large for one file
  xd.open_logs('s3://bucket/grid', '0:10:101 s')
      the runs of a sweep with keep=['log'] at common times, lazily
  xd.refine(model, steps=[...], keep='s3://bucket/levels')
      a run for each level; the same call goes on with those
  xd.error_budget(model, 'y', at='1 s', keep='s3://bucket/kept')
      each term, block of draws; also validate, certify
A file is written on this machine (in TMPDIR), uploaded whole, and downloaded whole before it is
read: its seal is of every byte, and nothing is believed before. Of a Zarr store each chunk is read
alone when it is used; xd.verify compares all of them with their digest, which does not depend on
how members were cut into chunks. With keep=['log'] whole runs stand beside its arrays, in runs/.
Members are added to a folder anywhere; to a Zarr store behind the last values of its axes, in
blocks as large as those that it was begun with. Until all are there, whoever opens it sees what was
before.
What is new is put only if nothing is there, and what replaces only if there still is what was
there: of two writers the second is refused in words, and nothing is lost. A lock that its process
does not renew is free after a minute, one that a dead process of this machine left at once.
xd.save_many(runs, 's3://bucket/runs') sends several files at once, and names them when all are
there: if one cannot be sent, none has changed; if the store fails between the first name and the
last, the error says how many have theirs.
"""
CLUSTER_PAGE = """\
sweep, refine, budget, validate and certify march many runs. Where they march changes no bit of a
result.
threads: nothing to type. dask's threads are used in Python (DASK_NUM_WORKERS=4 sets how many):
  study = xd.refine(model, steps=[...], compute=False); study.compute()
processes of this machine: each has its own Python, which helps where a run spends its time outside
of the march.
  xdynamics sweep MODEL.toml --axis "k=1:2:100 N m-1" -o DIR --workers 4
  with xd.cluster(4): study = study.compute()       # in a script, below if __name__ == "__main__":
machines of your own, with the same versions of xdynamics and a folder that all of them see:
  dask scheduler                                    # prints its address, like tcp://10.0.0.1:8786
  dask worker tcp://10.0.0.1:8786 --nworkers 4 --nthreads 1
  xdynamics refine MODEL.toml --step "10 ms" --levels 6 --scheduler tcp://10.0.0.1:8786
  with xd.cluster("tcp://10.0.0.1:8786"): study = study.compute()
  python pipelines/cluster_study/pipeline.py s3://bucket/results tcp://10.0.0.1:8786
SLURM: pip install dask-jobqueue; jobs of the queue are the workers. In Python, and in a shell
beside it:
  from dask_jobqueue import SLURMCluster
  cluster = SLURMCluster(cores=8, processes=8, memory="16 GB", walltime="01:00:00")
  cluster.scale(jobs=10)
  cluster.wait_for_workers(8)         # until the queue lets the first job begin; later ones join in
  print(cluster.scheduler_address)    # for --scheduler, or xd.cluster(address), while this lives
Kubernetes: pip install dask-kubernetes; the image has to have xdynamics[distributed] in it, the
cluster dask's operator:
  helm repo add dask https://helm.dask.org
  helm install --create-namespace -n dask-operator --generate-name dask/dask-kubernetes-operator
  from dask_kubernetes.operator import KubeCluster
  cluster = KubeCluster(name="xdynamics", image="yours/with-xdynamics:0.2", n_workers=10)
  cluster.wait_for_workers(1)
  kubectl port-forward service/xdynamics-scheduler 8786:8786 # --scheduler tcp://localhost:8786
Before anything is marched each worker is asked for its versions, math functions and engine; where
they differ from those here the verb, or xd.cluster, ends with a line for each; a Client of your own
is not asked. The finest level of a study begins first, and of several studies one ends before the
next one's coarse levels begin. A worker that is lost loses what it was marching, which another
marches again. Ctrl-C tells the cluster to drop what was asked of it; a march under way ends first.
The same command goes on: a sweep from its folder, refine --keep FOLDER with the levels that are
whole there (a folder that all machines see, or s3://bucket/levels), budget, validate and certify
--keep FOLDER with the numbers, terms, blocks of draws and cases that are known there; what is of
another version, or damaged, is made again.
Stages that list events need their number stated: --occurrences 10 (refine, validate).
"""


PRECISION_PAGE = """\
precision = "double_double" makes every number of a run the unevaluated sum of two floats: 31 digits
instead of 16.
  xdynamics run data/models/kepler.toml --method taylor --rtol 1e-28 --until "6.3 s" \\
      --precision double_double -o long.nc
  xd.simulate(model, method="taylor", rtol=1e-28, precision="double_double")
or, in a model file, [run] precision = "double_double".
When to use it: to see what rounding does to a run of floats, to follow a chaotic motion longer (31
digits last about twice as long as 16), and where 16 digits of a state are too few.
What counts as it is written: parameters, starts, literals in expressions, until, step, nodes and
times of `sample`, in their units: "0.1 N m-1" is a tenth, not the float next to it, and more digits
than a float has are read and kept in the archive. Coefficients of methods are fractions or
decimals; those of dop853 are published with 30 digits, those of taylor are exact. A table is the
floats that it is; so is a start or a parameter that an expression gives, u = "A*sin(index(site))":
where all 31 digits of it are to count, write the numbers out. Elementary functions are right to 30
digits, and all of it has the same bits on every machine.
What is stored: the float, where it always is, and beside it what the float does not hold, in the
same unit, to be added.
  x, v_x, a state s                 rest_x, rest_v_x, rest_s          at every row
  time                              rest_time                         at every row; the grid lies at
                                    the floats of a float run
  event_time                        rest_event_time                   at every event
  also in results of `sample`. Accelerations, forces, energies, observables, samples of forces and
  estimated errors are floats. The attribute `precision` says which a run has. What reads floats
  alone reads such a run like any other.
Adding them as floats would lose what was gained. With mpmath, decimal or fractions they add up
exactly:
  from fractions import Fraction
  run = xd.open_run("long.nc"); x = Fraction(float(run.x[-1])) + Fraction(float(run.rest_x[-1]))
A number is as right as the method made it: a fixed step leaves the truncation that it always
leaves, and only a small rtol uses the digits. The smallest is 5e-31; with taylor the order follows
from it. A motion is right to about 30 digits over tens of steps; rounding grows with the steps as
it does with floats, from 1e-32.
The rounding of a run of floats is its difference from its twin, the same run with 31 digits:
  xdynamics run data/models/kepler.toml --method rk4 --step "10 ms" --until "6.3 s" -o one.nc
  xdynamics run data/models/kepler.toml --method rk4 --step "10 ms" --until "6.3 s" \\
      --precision double_double -o twin.nc
  xdynamics compare one.nc twin.nc
  The line `rounding` says so, if precision is all that differs; differences are then of numbers
  with their rests. Where steps are chosen, march both by those of one of them: simulate(model,
  step=run.step_size[1:], until=...). In Python also
  xd.refine(model, precisions=["float64", "double_double"], method="rk4", step="10 ms")
  xdynamics refine data/models/kepler.toml --precisions --method rk4 --step "10 ms" --until "6.3 s"
`budget` measures its term of rounding by such a twin, for coordinates, velocities, states and times
of events. In sweeps precision is a setting or an axis; members are marched one by one, each from
its own texts, and what is kept of them are floats:
  xdynamics sweep data/models/kepler.toml --axis "precision=float64, double_double" \\
      --method rk4 --step "10 ms" --until "6.3 s" -o grid
`reproduce`, `verify`, `sign`, `extend`, --resume, `diagnose`, `plot` and `show` read such runs as
they do others.
What is refused, each with what to do instead:
  implicit methods                  their equations are solved in floats: take an explicit method,
                                    such as dop853, or taylor
  step doubling                     a difference of floats: take a method with an embedded formula,
                                    or a fixed step
  contacts, frictions               solved in floats: write an impact as an event with
                                    action = "reset"
  functions in Python               they return a float: write an expression
  scales, compensated sums          leave them out; a rest is carried of every number anyhow
  root_state = "interpolant"        leave it out: the state at an event is that of a shortened step
What it costs: a step takes 11 to 50 times as long as one of floats, a run of 6,000 steps with its
record 3 to 20 times, and compiling 0.1 to 4 s in the place of 0.04 to 0.25 s. The benchmark
  python tests/benchmarks/precision_cost.py
  prints these figures of nine cases on your machine.
"""


# … stands for the name of a quantity, an event or a contact
OF_RECORDS = {
    "row": "an accepted state, along `step`; at an event there are two at one time, event_before and event_after",
    "row_kind": "how a row was reached; a node is a time to land on that was asked for, or a breakpoint of a table",
    "trial": "a step that was rejected; trial_reason says why. An event_substep is not one: the step was cut to find an event",
    "sample": "an evaluation of the forces inside a step, with the state it used; `xdynamics sample` is something else, states at times",
    "error_…": "estimated error of the one step to this row, a local error; how far the row itself is off says `diagnose`",
    "error_norm": "error of a step over what the tolerances allow; steps above 1 are rejected",
    "event_detector": "what found the event: an event of the model, a contact, a friction, or a switch hidden in a force",
    "event_time_uncertainty": "of locating the event on this run alone; the error of the integration is not in it, `refine` has both",
    "step_number": "number of a row in the whole march, from 0: it survives every selection, and what names rows has these numbers",
    "event_row_before": "step_number of the row with the state on arrival; event_row_after: of the one it goes on from",
    "event_offset_…": "shift of a coordinate at an event, by a reset or by a contact that comes to rest",
    "switch": "a kink or jump inside a force, like drag.abs or drag.abs[3]: the zero of what abs, sign, min, max or where turn at",
    "touch": "an event function that reaches zero and turns back; a jump changes sign without passing zero, a pole at infinity",
    "cluster": "several events too close in time to be told apart",
    "rest": "a contact that closes and stays closed; takeoff: it opens; stick and slip: friction comes to hold, or gives way",
    "regime": "the set of forces that act, changed by an event with action = 'switch'",
    "run_outcome": "how the run ended: completed and stopped_by_event are as asked; run_outcome_text says it with t and h",
    "run_h_omega_largest": "largest step times fastest rate of the model: how finely its fastest motion was resolved",
    "run_uncontrolled": "how many variables have an absolute tolerance that lets errors come to 3 % of their size or more",
    "solver_until": "end that was asked for; an event may have ended the run before",
    "math_functions": "whose sin, exp … were used: the package's own, the same bits on every machine",
    "end_memory": "what `extend` needs to go on with the bits of one march",
    "model_toml": "the whole model as text, tables included: the archive alone is enough to march it again; along `document`",
    "content_digest": "sha256 of every variable and attribute but circumstances (versions, dates), which volatile_digest covers",
    "origin": "in memory alone: what the record was when it was marched or read, so that `save` notices an edit",
    "selection": "a part of a run, found again by `reproduce`; derived: data made from one by anything but a march",
    "evidence": "what is made from runs to judge them: refinement, budget, comparison …",
}
OF_EVIDENCE = {
    "level": "one run of a study, by its step or tolerance; from coarse to fine. In a budget the first is the run's own",
    "at": "times that were asked for, along which at_time has them; occurrence: the first, second … meeting of an event",
    "order_…": "observed order: how fast differences fall from level to level; below 0 they grow",
    "limit_…": "where the levels lead with ever smaller steps; nan unless the order can be relied on",
    "uncertainty_…": "of the finest level's number, numerical, at about 95 %; uncertainty_rule_… says where it is from",
    "gate_…": "of a refinement: passed where interpolation is off by no more than the difference to the next level",
    "scaled_difference_…": "difference over difference_scale_…, a size of the quantity that is never zero",
    "verdict_…": "what the levels show about a number, one of the six words below; it is no grade",
    "gate_verdict": "of a certificate: passed, failed, or not_checked, where there were too few draws to tell",
    "passed": "of a gate or case: nothing speaks against the number. The gate `convergence` passes unless a number is"
    " not_converging: beside pre_asymptotic it says that the uncertainty, the wider one, may be relied on",
    "refused": "of a case of the ledger: the method is not defined for it, as velocity Verlet for drag; no failure",
    "residual": "largest difference from a closed form; bound (case_bound): the most it may be; scaled_residual: over its size",
    "term": "one reason why a number may be off: numerical (of the march) or physical (an uncertain input, or a discrepancy)",
    "bound": "of a term: what it contributes at most; numerical_bound is the sum of those of the march",
    "total_rss": "standard uncertainty by all terms: the root of their sum of squares; numerical_rss, physical_rss of a kind",
    "share": "of a term in the variance; all together 100 %, correlated terms share what they have together",
    "standard_uncertainty_doubt": "how far an uncertainty itself may be off, as of few draws; so with every …_doubt",
    "result": "the number as it is written: ± is k times the standard uncertainty, a small one with its power of ten: ± 5.3e-7;"
    " numerical part: the march's bound within; where linear_verdict is not_adequate, the interval that holds its draws",
    "linear_verdict": "whether sums of squares will do, by comparison with draws: adequate, not_adequate, not_checked (draw more)",
    "monte_carlo_shortest": "shortest interval with the coverage among draws; symmetric leaves as many on either side",
    "adequate": "of a fit: its residuals are no more than the data's uncertainty; else budgets refuse the fitted model",
    "at_bound": "1 where an estimate ended on its bound; its uncertainty means nothing then",
    "band_…": "largest minus smallest value over the rows; drift_…: at the end minus at the start",
    "believed_until": "time until which no variable is further from the solution than a tenth of its range",
    "continuity_verdict": "whether each step, recomputed from its row, leads to the next; not the last row, nor jumps at events",
    "continuity_time": "start of the step whose defect is largest by its bound; continuity_steps: how many were recomputed",
    "continuity_defect_…": "largest distance of a recorded state from the recomputed one; continuity_bound_…: what rounding explains",
    "companion": "a second run at a tighter setting, from which the error of the first follows",
    "phase_offset": "phase at the end of a cycle minus that of the reference; negative where the run lags behind",
    "maximum_…": "over the whole run; maximum_…_rule: sampled at a row, interpolated between rows, or located by an event",
    "identical": "1 where two runs agree in every bit; first_row: the first row of a variable that does not",
}
OF_FILES = {
    "verified": "every digest and the seal agree with the data; repacked: another program wrote them, and every number agrees",
    "edited": "a sound file that says something else than was archived; damaged: bytes differ from the seal, or cannot be read",
    "content": "names, dimensions, types, units, values and settings, by value; notes (history, comment, institution) are none",
    "seal": "sha256 over the bytes of a file, at its end; a signature (RUN.nc.sig) says whose it is",
    "reproduce": "marches a run again from its archive and compares every bit; recheck does so with a certificate",
    "segments": "finished parts of a run beside its archive until it is whole; --resume goes on from them, discard removes them",
    "partial": "run.partial.nc: a run that ended badly, beside the archive of one that ended well",
    "ledger": "what a method makes of problems with closed forms, case by case",
    "certificate": "one number with its budget, gates and ledger, made again by recheck; a bundle is a folder with all of it",
}


def words_page() -> Iterator[str]:
    """Yield the lines of the page: each word with what it means."""
    yield from wrapped_lines(
        "Names that do not explain themselves; … stands for the name of a quantity or an event. All others: help record."
    )
    for title, words in (
        ("Of records", OF_RECORDS),
        ("Of evidence", OF_EVIDENCE),
        ("Verdicts on convergence (verdict_…, level_verdict)", MEANINGS),
        ("Of files and verbs", OF_FILES),
    ):
        yield title
        yield from _word_lines(words)


def _word_lines(words: Mapping[str, str]) -> Iterator[str]:
    width = max(map(len, words))
    for word, meaning in words.items():
        yield from wrapped_lines(f"  {word:{width}}  {meaning}", width + 4)
