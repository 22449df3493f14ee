"""An example for every verb, at the foot of its help."""

from __future__ import annotations

from xdynamics.cli import budgeting, judging, looking, marching, model_writing, proving, sweeping  # noqa: F401 - the verbs
from xdynamics.cli.command import main

EXAMPLES = {
    "animate": "xdynamics animate orbit.nc -o orbit.gif --seconds 8",
    "budget": "xdynamics budget data/models/rocket_c6.toml --quantity y --event apogee --draws 512 -o budget.nc",
    "bundle": "xdynamics bundle apogee.nc -o apogee",
    "certify": "xdynamics certify data/models/rocket_c6.toml --quantity y --event apogee -o apogee.nc",
    "check": "xdynamics check data/models/ball_drag.toml",
    "compare": "xdynamics compare ball.nc fine.nc",
    "complete": "xdynamics complete orbit.nc -o whole.nc",
    "diagnose": "xdynamics diagnose orbit.nc -o diagnosis.nc",
    "discard": "xdynamics discard ball.nc",
    "enclose": 'xdynamics enclose data/models/harmonic_oscillator.toml --until "10 s" -o tube.nc',
    "extend": 'xdynamics extend orbit.nc --until "60 s" -o longer.nc',
    "fit": "xdynamics fit data/models/bench_pendulum.toml bench.csv --parameter length --parameter damping -o fit.nc",
    "help": "xdynamics help events",
    "methods": "xdynamics methods dop853",
    "modes": "xdynamics modes data/models/coupled_masses.toml",
    "new": "xdynamics new pendulum.toml",
    "plot": "xdynamics plot orbit.nc; xdynamics plot orbit.nc -o orbit.pdf --only plane,energy",
    "recheck": "xdynamics recheck apogee",
    "refine": 'xdynamics refine data/models/ball_drag.toml --step "40 ms" --levels 4 --at "1 s" -o study.nc',
    "report": "xdynamics report apogee -o apogee.html",
    "reproduce": "xdynamics reproduce ball.nc",
    "run": 'xdynamics run data/models/ball_drag.toml -o ball.nc --set vt="35 m s-1" --times "0:3:31 s"',
    "sample": 'xdynamics sample ball.nc --times "0:3:31 s" -o ball.csv',
    "show": "xdynamics show ball.nc",
    "sign": "xdynamics sign ball.nc --new-key key.pem",
    "sweep": 'xdynamics sweep data/models/ball_drag.toml --axis "vt=20:60:9 m s-1" --rtol 1e-8 -o balls',
    "table": "xdynamics table ball.nc --of events -o events.csv",
    "validate": "xdynamics validate --method dop853 -o ledger.nc",
    "verify": "xdynamics verify ball.nc",
}

for name, example in EXAMPLES.items():
    main.commands[name].epilog = f"\b\nFor example:\n  {example}"
