"""The guide's pages on runs and their files, on how a march finds events and contacts, on evidence, and on many runs."""

from __future__ import annotations

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
