"""The page `xdynamics help precision`: runs whose numbers have 31 digits."""

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
