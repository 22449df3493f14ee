"""The explicit midpoint method: a trial half step, then a full step with the slopes there."""

from xdynamics.methods.method import Method

MIDPOINT = Method(
    name="midpoint",
    synonyms=("modified Euler", "Runge's method", "second-order Runge-Kutta"),
    order=2,
    symplectic=False,
    evaluations=2,
    update="""
        qm = q + h/2*v
        vm = v + h/2*a
        xm = x + h/2*r
        am, rm = f(t + h/2, qm, vm, xm)
        q1 = q + h*vm
        v1 = v + h*am
        x1 = x + h*rm
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words=(
        "a half step with the old velocity and acceleration, the force there at t + h/2, a full step with both, then"
        " the force"
    ),
    reference=(
        "Runge 1895, Math. Ann. 46, 167, doi:10.1007/BF01446807; Hairer, Norsett, Wanner I, section II.1, eq. (1.3)"
    ),
)

METHODS = (MIDPOINT,)
