# %% [markdown]
# # From measurements to parameters
#
# So far the parameters were given. In the laboratory it is the other way round: positions are measured, and the drag is
# what one wants to know. Here the "measurements" are made by the model itself, with noise of a known size, so that we know
# what the fit has to find. It is the test to do before one trusts it with real data.

# %%
import numpy as np
import pandas as pd

import xdynamics as xd

cart = xd.Model(
    name="Cart on a spring with friction in its bearings",
    coordinates={"x": "m"},
    parameters={"m": "0.5 kg", "k": "20 N m-1", "c": "0.12 kg s-1"},
    mass={"x": "m"},
    forces={"spring": {"potential": "k*x**2/2"}, "bearing": {"x": "-c*v_x"}},
    initial={"x": "0.1 m", "v_x": "0 m s-1"},
)
settings = {"method": "dop853", "rtol": 1e-9, "until": "6 s"}
times = np.linspace(0.0, 6.0, 121)
clean = xd.simulate(cart, times=times, **settings)
noise = 0.5e-3  # m
measured = pd.DataFrame(
    {"time [s]": times, "x [m]": clean.x.values + noise * np.random.default_rng(7).standard_normal(times.size)}
)
measured["u(x) [m]"] = noise
measured.head()

# %% [markdown]
# ## Look before you fit
#
# The guess is wrong on purpose. What is drawn beside the run are the measurements with their bars.

# %%
guess = cart.replace(parameters={"k": "18 N m-1", "c": "0.3 kg s-1"})
xd.plot(xd.simulate(guess, **settings), only="x", beside=measured)

# %%
fit = xd.fit(guess, measured, parameters=["k", "c"], **settings)
estimates, doubts = fit.estimate.values, fit.standard_uncertainty.values
for name, value, doubt, truth in zip(("k", "c"), estimates, doubts, (20.0, 0.12), strict=True):
    print(f"{name} = {value:.4f} ± {doubt:.4f}, was {truth}")
xd.plot(fit)

# %% [markdown]
# The estimates differ from the truth by about their uncertainties: not by much less, which would say that the bars are too
# long, and not by much more. Residuals that look like noise are what supports the model; a slow wave in them would say
# that a force is missing, however small the sum of squares.

# %% [markdown]
# ## To do
#
# 1. Leave out the bearing (`c` fixed at zero). What do the residuals look like, and what happens to the uncertainty of `k`?
# 2. Measure at 12 times instead of 121. How do the uncertainties change, and why by that factor?
# 3. Make the noise of every fifth point ten times larger without saying so. Which test notices?
