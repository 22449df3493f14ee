# %% [markdown]
# # What a number is worth
#
# A ball is thrown upward with quadratic drag. How high does it rise? The program prints sixteen digits, of which
# some come from the method, some from the location of the event, and most from nothing at all: the terminal speed is known to
# three per cent. A number without its uncertainty is no result.

# %%
import xdynamics as xd

ball = xd.Model(
    name="Ball thrown upward",
    coordinates={"y": "m"},
    parameters={
        "m": "0.145 kg",
        "g": "9.80665 m s-2",
        "vt": {"value": "30 m s-1", "uncertainty": 1, "description": "terminal speed"},
    },
    mass={"y": "m"},
    forces={"gravity": {"potential": "m*g*y"}, "drag": {"y": "-m*g*v_y*abs(v_y)/vt**2"}},
    initial={"y": "0 m", "v_y": {"value": "20 m s-1", "uncertainty": 0.2}},
    events={"apex": {"function": "v_y", "direction": "falling", "action": "stop"}},
)
run = xd.simulate(ball, method="midpoint", step="10 ms", until="5 s")
print(f"{float(run.y[-1])!r} m")

# %% [markdown]
# ## The numerical part
#
# Refine the step. Differences of neighbouring levels fall as the order promises, so the last one bounds what is left.

# %%
study = xd.refine(ball, method="midpoint", steps=["40 ms", "20 ms", "10 ms", "5 ms"], occurrences=1, until="5 s")
xd.plot(study)

# %% [markdown]
# ## The budget
#
# Every input with an uncertainty is a term, and so is every part of the arithmetic. Each contributes its sensitivity times its
# uncertainty; independent terms add as squares. The picture says where a better instrument would help. It is not
# the step.

# %%
budget = xd.error_budget(ball, quantity="y", event="apex", method="midpoint", step="10 ms", until="5 s")
height, doubt = float(budget.value), float(budget.total_rss)
print(f"height {height:.2f} ± {doubt:.2f} m")
xd.plot(budget)

# %% [markdown]
# Without drag $h = v^2/2g$, with it $h = (v_t^2/2g) \ln(1 + v^2/v_t^2)$. The slopes of the budget are the derivatives of
# that formula, which nobody told the program.

# %%
slopes = dict(zip(map(str, budget.term_name.values), map(float, budget.sensitivity.values), strict=True))
print({name: round(slope, 6) for name, slope in slopes.items() if name in ("vt", "v_y")})

# %% [markdown]
# ## To do
#
# 1. Which step makes the numerical part a tenth of the physical one? What would a step a hundred times smaller buy?
# 2. Correlate `vt` and `v_y` (`[correlations]`). Does the uncertainty grow or shrink, and why?
# 3. Draw 10,000 members (`draws=10000`). Is the linear budget adequate?
