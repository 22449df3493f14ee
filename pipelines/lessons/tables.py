# %% [markdown]
# # Four tables
#
# A number that somebody else is to check needs the rows that it came from. Four tables do: the states that were accepted, the
# events with both of their sides, the same number at finer and finer steps, and what was compared with a law that is
# known. A bead falls through oil, where all four can be compared with closed forms: with the drag $-b v$ it is at
# $y = v_\infty (t - \tau (1 - e^{-t/\tau}))$, with $\tau = m/b$ and $v_\infty = g \tau$.

# %%
import numpy as np

import xdynamics as xd

bead = xd.Model(
    name="Bead falling through oil",
    coordinates={"y": "m"},
    parameters={"m": "2 g", "b": "20 g s-1", "g": "9.81 m s-2", "depth": "0.5 m"},
    mass={"y": "m"},
    forces={"weight": {"y": "m*g"}, "drag": {"y": "-b*v_y"}},
    initial={"y": "0 m", "v_y": "0 m s-1"},
    events={"floor": {"function": "y - depth", "direction": "rising", "action": "stop"}},
    validation={
        "fall": {
            "quantity": "y",
            "expression": "g*m/b*(t - m/b*(1 - exp(-b*t/m)))",
            "bound": "order",
            "times": ["0.2 s", "0.4 s"],
        }
    },
    run={"method": "rk4", "step": "10 ms", "until": "2 s"},
)
run = xd.simulate(bead)

# %% [markdown]
# ## The states
#
# One row for each accepted state, with the unit of each number in its header. `xdynamics table run.nc -o states.csv` writes the
# same from a shell, and `.xlsx`, `.md` or `.tex` by the ending.

# %%
states = run.dynamics.table("steps")
states[["time [s]", "y [m]", "v_y [m s-1]", "kinetic_energy [J]"]].head()

# %% [markdown]
# ## The events
#
# An event is located between two states. Its row says between which times, how well its time is known, what the event
# function still is there, and every quantity before and after.

# %%
events = run.dynamics.table("events")
lands = float(events["event_time [s]"].iloc[0])
tau, final = 0.1, 0.981  # s, m s-1
fallen = final * (lands - tau * (1.0 - np.exp(-lands / tau)))
print(f"by the closed form {fallen:.12g} m at that time")
events.T

# %% [markdown]
# ## The convergence record
#
# One row for each step, one column for every number, the difference to the next finer row, and the order in which it falls:
# four, for `rk4`. The last difference is what a reader needs, not the last digit.

# %%
study = xd.refine(bead, steps=["40 ms", "20 ms", "10 ms", "5 ms"], at=["0.4 s"], observables=["y"], occurrences=1)
levels = study.dynamics.table("levels")
levels.iloc[:, :6]

# %% [markdown]
# ## The validation ledger
#
# One row for each comparison: with what, by how much, and how much it may be off. A row that failed would say so, and
# one that could not be compared would say why.

# %%
ledger = xd.validate(bead)
cases = ledger.dynamics.table("cases")
cases[["case_name", "verdict", "residual", "bound", "case_units"]]

# %% [markdown]
# ## To do
#
# 1. Halve the step of the run. Which columns of the four tables change, and by which factor?
# 2. Write `validation` with the closed form of the velocity. What does the ledger say if you forget the minus sign of the exponent?
# 3. Which of the four would you print in a report of two pages, and which would you keep in a file beside it?
