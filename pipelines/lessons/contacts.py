# %% [markdown]
# # Where the ground is
#
# A smooth update rule knows nothing of the floor. If a ball is found below it at the end of a step, the impact was
# somewhere within: the event has to be *located*, the impact applied there, and the rest of the step marched with what is new.
# The record keeps the bracket, the accepted time and the states on both sides.

# %%
import numpy as np

import xdynamics as xd

ball = xd.Model(
    name="Bouncing ball",
    coordinates={"y": "m"},
    parameters={"m": "0.2 kg", "g": "9.81 m s-2", "e": "0.8"},
    mass={"y": "m"},
    forces={"gravity": {"potential": "m*g*y"}},
    initial={"y": "1 m", "v_y": "0 m s-1"},
    contacts={"floor": {"gap": "y", "restitution": "e"}},
)
run = xd.simulate(ball, method="velocity_verlet", step="10 ms", until="5 s")
run

# %%
xd.plot(run)

# %% [markdown]
# With constant weight every time is known in closed form: the first impact at $\sqrt{2h/g}$, each flight shorter by the
# restitution. So the recorded times can be judged, and the uncertainty that stands beside them, too.

# %%
impacts = run.dynamics.events("floor")
first = np.sqrt(2.0 / 9.81)
expected = first * np.concatenate([[1.0], 1.0 + 2.0 * np.cumsum(0.8 ** np.arange(1, 5))])
errors = impacts.event_time.values[:5] - expected
for time, error, doubt in zip(expected, errors, impacts.event_time_uncertainty.values, strict=False):
    print(f"{time:.9f} s, off by {error:+.1e} s, located within {doubt:.1e} s")

# %% [markdown]
# ## Infinitely many impacts in finite time
#
# The flights sum to $\sqrt{2h/g}\,(1+e)/(1-e)$. Nobody marches through infinitely many impacts: what remains is summed, the ball is
# put to rest there, and from then on the floor carries it. The contact force is then the weight, which is solved for and not put in.

# %%
rest = float(impacts.event_time[-1])
accumulation = first * (1.0 + 0.8) / (1.0 - 0.8)
print(f"at rest at {rest:.6f} s, the series ends at {accumulation:.6f} s")
print(f"the floor holds {float(run.contact_force_floor[-1]):.4f} N")

# %% [markdown]
# ## What happens if one does not look
#
# Let the floor be a stiff spring instead, and take the same step. The ball sinks in, and every bounce differs from the
# last by what the step made of it: energy appears from nowhere. The refinement says so before anybody draws a conclusion.

# %%
stiff = xd.Model(
    name="Ball on a stiff spring",
    coordinates={"y": "m"},
    parameters={"m": "0.2 kg", "g": "9.81 m s-2", "k": "20000 N m-1"},
    mass={"y": "m"},
    forces={
        "gravity": {"potential": "m*g*y"},
        "floor": {"y": "k*max(-y, 0*metre)", "smooth": True},
    },
    initial={"y": "1 m", "v_y": "0 m s-1"},
)
levels = {"steps": ["4 ms", "2 ms", "1 ms", "0.5 ms"], "at": ["2 s"], "until": "2 s", "observables": ["y"]}
study = xd.refine(stiff, method="velocity_verlet", **levels)
xd.plot(study)

# %% [markdown]
# ## To do
#
# 1. Give the floor an amplitude: `gap = "y - A*sin(w*t)"`. When does the ball never come to rest?
# 2. How small must `rest_height` be before the resting time no longer depends on it?
# 3. Two balls, one above the other: which impact law conserves what, and what does the record say of their order?
