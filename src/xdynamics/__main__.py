"""``python -m xdynamics``: the command line."""

from xdynamics.cli import main

if __name__ == "__main__":
    main(prog_name="xdynamics")
