# %% [markdown]
# # One step after another
#
# Most force laws admit no closed-form trajectory. So the motion is advanced one small time step at a time, by an update rule
# that uses the force at the old state. Here a mass on a spring is marched by two rules that differ in the order of
# two lines, and then we ask how much of what they print is worth believing.
#
# The model statement comes before the first update: coordinates with units, parameters, the force, the start.

# %%
import numpy as np

import xdynamics as xd

oscillator = xd.Model(
    name="Mass on a spring",
    coordinates={"x": "m"},
    parameters={"m": "1 kg", "k": "4 N m-1"},
    mass={"x": "m"},
    forces={"spring": {"potential": "k*x**2/2"}},
    initial={"x": "1 m", "v_x": "0 m s-1"},
)
omega = 2.0  # sqrt(k/m), per second
h = 0.05  # s
[xd.METHODS[name].equations() for name in ("forward_euler", "euler_cromer")]

# %% [markdown]
# Forward Euler moves the position with the *old* velocity, Euler-Cromer with the *new* one. Update order is part of the
# definition of a method: the two lines in the other order are another method. What the program warns of is the
# subject of the next cells.

# %%
euler = xd.simulate(oscillator, method="forward_euler", step=h, until="20 s")
cromer = xd.simulate(oscillator, method="euler_cromer", step=h, until="20 s")
xd.plot([euler, cromer], only=["x", "phase", "energy"])

# %% [markdown]
# The spiral of forward Euler is no physics: the force is conservative. One step multiplies the energy by $1 + (\omega h)^2$,
# whatever the state. After $n$ steps that is a prediction to test, digit by digit.

# %%
n = euler.sizes["step"] - 1
growth = float(euler.total_energy[-1] / euler.total_energy[0])
predicted_growth = (1.0 + (omega * h) ** 2) ** n
print(f"{n} steps: energy grew by {growth:.9g}, predicted {predicted_growth:.9g}")

# %% [markdown]
# Euler-Cromer has unit determinant: the area in the phase plane stays, and the energy stays within a band. But it is
# off in its own way. Its numerical frequency is $\arccos(1 - (\omega h)^2/2)/h$, slightly too high, and the phase that this
# costs grows from cycle to cycle. Bounded energy is not accuracy.

# %%
found = xd.diagnose(cromer)
period = float(found.period.mean())
numerical_period = 2.0 * np.pi * h / np.arccos(1.0 - (omega * h) ** 2 / 2.0)
print(f"period {period:.5f} s; by the discrete law {numerical_period:.5f} s; of the spring {2 * np.pi / omega:.5f} s")
xd.plot(found)

# %% [markdown]
# ## How does the error change with the step?
#
# Halve the step and compare at common *times*, not at common row numbers. Where the difference of neighbouring levels halves
# too, the method shows its first order; that of velocity Verlet falls to a quarter. The order says how an error changes. It does
# not say whether a step is small enough for you: that is what the last difference is for.

# %%
levels = {"steps": ["40 ms", "20 ms", "10 ms", "5 ms"], "at": ["3 s"], "until": "3 s", "observables": ["x"]}
studies = {
    name: xd.refine(oscillator, method=name, **levels) for name in ("forward_euler", "euler_cromer", "velocity_verlet")
}
orders = {name: float(study.order_x[-2, 0]) for name, study in studies.items()}
print({name: round(order, 3) for name, order in orders.items()})
xd.plot(studies)

# %% [markdown]
# ## To do
#
# 1. March with a step of 1.01 s and of 0.99 s by `euler_cromer`. Where does the bounded curve end, and why there?
# 2. Add a drag `"-c*v_x"`. Which of the methods refuses it, and what does its message propose?
# 3. What is the largest step for which `x` at 3 s is known to 1 mm by each method? What does each cost in force evaluations?
