"""Draw every model of data/models as its own settings march it, and write data/README.md around the pictures.

python tests/gallery.py
"""

from __future__ import annotations

import warnings

import xdynamics as xd
from cases.problems import MODELS, ROOT

HEAD = """# Models, and what they do

Each is a file to copy. Each picture is `xdynamics run MODEL.toml -o run.nc`, then `xdynamics plot run.nc -o picture.png`,
with what stands in its `[run]`. `xdynamics check MODEL.toml` prints its equations; sources and units stand in the files.
"""


def page() -> str:
    """Write the page."""
    entries = []
    for path in sorted(MODELS.glob("*.toml")):
        model = xd.Model.from_toml(path)
        said = " ".join(model.description.split())
        link = f"[{path.name}](models/{path.name})"
        entries.append(
            f"## {model.name}\n\n{link}{f': {said}' if said else ''}\n\n![{model.name}](figures/{path.stem}.png)\n"
        )
    return "\n".join([HEAD, *entries])


def main() -> None:
    """Draw and write."""
    warnings.simplefilter("ignore")
    for path in sorted(MODELS.glob("*.toml")):
        xd.plot(xd.simulate(xd.Model.from_toml(path)), ROOT / "data" / "figures" / f"{path.stem}.png", dpi=70)
    (ROOT / "data" / "README.md").write_text(page())


if __name__ == "__main__":
    main()
