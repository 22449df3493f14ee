"""Ten smooth models with uncertain starts and constants, whose motions are marched at random within them."""

from __future__ import annotations

from typing import Any

from xdynamics import Model


def within(value: str, half_width: float) -> dict[str, Any]:
    """Return a number with bounds."""
    return {"value": value, "half_width": half_width}


def of_states(name: str, rates: dict[str, str], starts: dict[str, Any], **parameters: Any) -> Model:
    """Return a model of pure numbers and their rates."""
    states = {key: {"unit": "1", "rate": f"({rate})/second"} for key, rate in rates.items()}
    return Model(name=name, states=states, parameters=parameters, initial=starts)


def of_forces(name: str, forces: dict[str, str], starts: dict[str, Any], **parameters: Any) -> Model:
    """Return a model of coordinates in metres with masses of 1 kg; forces in newtons, as if metres and seconds were numbers."""
    units = {"M": "1 m", "S": "1 s", "N": "1 N"}
    return Model(
        name=name,
        coordinates={key: {"unit": "m"} for key in forces},
        parameters={"m": "1 kg", **units, **parameters},
        mass=dict.fromkeys(forces, "m"),
        forces={f"on_{key}": {key: f"N*({force})"} for key, force in forces.items()},
        initial=starts,
    )


# model, until when in s, and how much wider than its members the tube may be
MOTIONS: dict[str, tuple[Model, float, float]] = {
    "oscillator": (
        of_forces("oscillator", {"x": "-k*x/M"}, {"x": within("1 m", 0.01), "v_x": "0 m s-1"}, k=within("4", 0.02)),
        4.0,
        1.6,
    ),
    "duffing": (
        of_forces(
            "Duffing",
            {"x": "-k*x/M - 0.1*(x/M)**3"},
            {"x": within("1 m", 0.005), "v_x": "0 m s-1"},
            k=within("1", 0.01),
        ),
        6.0,
        2.5,
    ),
    "pendulum": (
        of_forces(
            "pendulum",
            {"x": "-sin(x/M) - b*v_x*S/M"},
            {"x": within("2 m", 0.01), "v_x": "0 m s-1"},
            b=within("0.1", 0.01),
        ),
        5.0,
        2.5,
    ),
    "van_der_pol": (
        of_forces(
            "van der Pol",
            {"x": "-x/M + (1 - (x/M)**2)*v_x*S/M"},
            {"x": within("2 m", 0.001), "v_x": within("0 m s-1", 0.001)},
        ),
        4.0,
        2.0,
    ),
    "kepler": (
        of_forces(
            "Kepler",
            {"x": "-(x/M)/((x/M)**2 + (y/M)**2)**1.5", "y": "-(y/M)/((x/M)**2 + (y/M)**2)**1.5"},
            {"x": within("0.8 m", 1e-4), "y": "0 m", "v_x": "0 m s-1", "v_y": within("1.2 m s-1", 1e-4)},
        ),
        4.0,
        2.0,
    ),
    "henon_heiles": (
        of_forces(
            "Henon and Heiles",
            {"x": "-(x + 2*x*y/M)/M", "y": "-(y + x**2/M - y**2/M)/M"},
            {"x": within("0 m", 0.002), "y": within("0.1 m", 0.002), "v_x": "0.3 m s-1", "v_y": "0.1 m s-1"},
        ),
        6.0,
        2.0,
    ),
    "driven": (
        of_forces(
            "driven",
            {"x": "-x/M - (x/M)**3/6 + 0.2*cos(w*t/S)"},
            {"x": within("0.5 m", 0.005), "v_x": "0 m s-1"},
            w=within("0.7", 0.002),
        ),
        5.0,
        2.0,
    ),
    "lorenz": (
        of_states(
            "Lorenz",
            {"x": "10*(y - x)", "y": "x*(rho - z) - y", "z": "x*y - 8*z/3"},
            {"x": within("1", 1e-3), "y": "1", "z": "1"},
            rho=within("28", 1e-3),
        ),
        0.8,
        2.0,
    ),
    "roessler": (
        of_states(
            "Roessler",
            {"x": "-y - z", "y": "x + a*y", "z": "0.2 + z*(x - 5.7)"},
            {"x": within("1", 1e-3), "y": within("2", 1e-3), "z": "0.1"},
            a=within("0.2", 1e-3),
        ),
        4.0,
        2.0,
    ),
    "predators": (
        of_states(
            "predators and prey",
            {"x": "x*(1.5 - y)", "y": "y*(x - c)"},
            {"x": within("2", 0.002), "y": within("1", 0.002)},
            c=within("1", 0.002),
        ),
        4.0,
        2.0,
    ),
}
