# %% [markdown]
# # Where prediction ends
#
# Lorenz's three equations are short, smooth and deterministic. Two runs that begin a billionth apart are soon as
# different as any two. That is a property of the equations, not of the method; so the first task is to tell the two apart.

# %%
import numpy as np

import xdynamics as xd

lorenz = xd.Model(
    name="Lorenz",
    time={"unit": "1"},
    parameters={"sigma": "10", "rho": "28", "beta": {"value": 8 / 3, "unit": "1"}},
    states={
        "x": {"unit": "1", "rate": "sigma*(y - x)"},
        "y": {"unit": "1", "rate": "x*(rho - z) - y"},
        "z": {"unit": "1", "rate": "x*y - beta*z"},
    },
    initial={"x": "1", "y": "1", "z": "20"},
    figure={"plane": ["x", "z"]},
)
settings = {"method": "dop853", "rtol": 1e-12, "atol": 1e-12, "until": "25"}
run = xd.simulate(lorenz, **settings)
xd.plot(run)

# %% [markdown]
# ## Two neighbours
#
# The second run begins $10^{-9}$ beside the first. On a logarithmic axis their distance is a straight line until it is as
# large as the attractor: an exponential, whose rate is the largest Lyapunov exponent.

# %%
neighbour = xd.simulate(lorenz.replace(initial={"x": "1.000000001"}), **settings)
distance = xd.compare(run, neighbour, times="0:25:501")
xd.plot(distance)

# %%
apart = np.abs(distance.difference_x.values)
early = (distance.at_time.values > 2.0) & (distance.at_time.values < 16.0)
slope = float(np.polyfit(distance.at_time.values[early], np.log(apart[early]), 1)[0])
print(f"the distance grows as exp({slope:.2f} t)")

# %% [markdown]
# ## Exponents with uncertainties
#
# Perturbations carried along by the method's own derivative give all three exponents. Their sum is known exactly:
# volumes shrink at the rate $\sigma + 1 + \beta = 13.667$. A number that must come out is worth more than one that
# looks plausible.

# %%
found = xd.diagnose(xd.simulate(lorenz, method="rk4", step="0.01", until="200"), lyapunov=True)
exponents = found.lyapunov_exponents.values
print(f"sum {exponents.sum():.4f}, must be {-(10 + 1 + 8 / 3):.4f}")
xd.plot(found)

# %% [markdown]
# ## To do
#
# 1. By how much does the time until the two runs part grow when the start is known to three more digits? Check it.
# 2. Refine at t = 5 and at t = 40. What is the verdict at each, and what may be said of the state at 40?
# 3. Set `rho` to 20. Where do all runs end, and what is the sign of the largest exponent there?
