# %% [markdown]
# # Many bodies, and what they conserve
#
# Three equal masses can chase one another along a figure of eight (Moore 1993; Chenciner and Montgomery 2000). The law of
# gravity is written once, for every pair. No forces are put in by hand, so that what must be conserved is: momentum,
# energy, angular momentum. They are the first check of any run that has no closed form.

# %%
import numpy as np

import xdynamics as xd

eight = xd.Model.from_toml("data/models/figure_eight.toml")
print(eight.to_toml())

# %%
run = xd.simulate(eight)
xd.plot(run)

# %% [markdown]
# ## Two ways to be accurate
#
# A method of high order with small steps errs little, but in one direction; a symplectic one of low order errs more, to
# both sides. Over a few periods the first wins. Ask again after ten thousand.

# %%
until = float(run.time[-1])
verlet = xd.simulate(eight, method="velocity_verlet", step=until / 4000, until=until)
kutta = xd.simulate(eight, method="rk4", step=until / 500, until=until)
xd.plot({"velocity Verlet": verlet, "Runge-Kutta": kutta}, only=["energy", "plane"])

# %%
momentum = {
    name: float(np.abs((each.v_r.isel(step=-1) - each.v_r.isel(step=0)).sum("body")).max())
    for name, each in {"velocity Verlet": verlet, "Runge-Kutta": kutta}.items()
}
bands = {name: float(np.ptp(each.total_energy.values)) for name, each in (("Verlet", verlet), ("Runge-Kutta", kutta))}
print("change of the sum of all velocities:", {name: f"{change:.1e} m/s" for name, change in momentum.items()})
print("band of the energy:", {name: f"{band:.2e} J" for name, band in bands.items()})

# %%
xd.animate(run, seconds=3.0, rate=12)

# %% [markdown]
# ## To do
#
# 1. Move one body by a thousandth. Does the eight survive ten periods?
# 2. Give one body twice its mass. What does the energy tell you of the method, and what of the motion?
# 3. March backwards from the end, `until` at the start. How near does each method come to where it began?
