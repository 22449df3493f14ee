"""What to write in the place of a function of scipy that is called at every step: it takes numbers, not yet known ones."""

from __future__ import annotations

from types import TracebackType

SCIPY = "scipy"
TABULATED = (
    "before the run tabulate it over what it depends on, x = np.linspace(...), and write np.interp(y[0], x, table)"
)
REMEDIES = {
    "integrate": (
        "makes an integral at every step; let the integral be a state of its own, whose rate is what is integrated"
        f" (dI/dt = g(y)*dy/dt), or {TABULATED}"
    ),
    "optimize": (
        "solves an equation at every step; let its unknown z be a state of its own, dz/dt = -(dg/dy*dy/dt)/(dg/dz) for"
        f" g(y, z) = 0, with its solution at the start; or {TABULATED}"
    ),
    "interpolate": "looks up a table; write numpy.interp(t, x, y) in the place of an interpolator of scipy",
    "special": f"is no function of the language of expressions; {TABULATED}",
    "linalg": "is no function of the language of expressions; write np.linalg.solve for six unknowns at most, or @",
}
OTHER = f"takes numbers, which are not known yet; {TABULATED}"


def scipy_remedy(trace: TracebackType | None) -> str:
    """Return which scipy function an error came from, and its replacement; empty if from none.

    Parameters
    ----------
    trace : traceback
        Of the error.
    """
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__", ""))
        if module.partition(".")[0] == SCIPY:
            return _remedy_of_call(module, trace.tb_frame.f_code.co_qualname)
        trace = trace.tb_next
    return ""


def _remedy_of_call(module: str, function: str) -> str:
    package = module.split(".")[1] if "." in module else ""
    public = function.removesuffix(".__call__").removesuffix(".__init__").rpartition(".<locals>.")[2]
    name = ".".join([SCIPY, *(part for part in (package, public) if part and not part.startswith("_"))])
    return f"the function calls {name}, which {REMEDIES.get(package, OTHER)}"


def special_remedy(name: str) -> str:
    """Return how to replace a function of scipy.special, which works element by element."""
    return f"the function calls {SCIPY}.special.{name}, which {REMEDIES['special']}"
