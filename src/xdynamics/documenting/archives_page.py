"""The page `xdynamics help archives`: runs in files, by time and many together, with xarray alone where that is enough."""

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
