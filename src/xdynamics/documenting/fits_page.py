"""The guide's page on fits."""

from __future__ import annotations

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
