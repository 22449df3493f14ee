"""The build backend of xdynamics: a wheel with the LLVM text of the engine, a source distribution with tests.

`pyproject.toml` names it: setuptools' backend, with three additions. numba makes the text while a wheel is built, each
part in a process of its own, a minute on two cores, or it is taken from the user's cache; the wheel is then one of a
platform. An editable installation has no text. A source distribution holds all that the repository does.
"""

from __future__ import annotations

import os
import sysconfig
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

__all__ = [
    "PlatformWheel",
    "SourceDistribution",
    "TextsOfEngine",
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

COMPILERS = ("numpy", "numba", "llvmlite")  # what compiling the engine needs
FOLDERS = ("tests", "data", "pipelines")


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return what building a wheel needs: setuptools' own requirements, and what compiles the engine."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    compilers = [requirement for requirement in project["dependencies"] if requirement.startswith(COMPILERS)]
    return [*build_meta.get_requires_for_build_wheel(config_settings), *compilers]


class TextsOfEngine(build_py):
    """Put the engine's LLVM texts beside the modules, unless these stay where they are."""

    def run(self) -> None:
        """Copy the modules, then make the texts."""
        super().run()
        if self.editable_mode:
            return
        from xdynamics.kernels.engine_part import FOLDER, PACKAGE

        folder = Path(self.build_lib) / PACKAGE.name / FOLDER.relative_to(PACKAGE)
        folder.mkdir(parents=True, exist_ok=True)
        with ProcessPoolExecutor(os.cpu_count()) as processes:
            for name, text in processes.map(_packed_text, range(len(_parts()))):
                (folder / name).write_bytes(text)


def _parts() -> tuple[Any, ...]:
    from xdynamics.dynamics.growth import GROWTH
    from xdynamics.march.engine import PARTS

    return (*PARTS, GROWTH)


def _packed_text(number: int) -> tuple[str, bytes]:
    """Return the file's name and the text of one part of the engine."""
    part = _parts()[number]
    return part.file_name, part.packed_text()


class PlatformWheel(bdist_wheel):
    """A wheel for any Python 3 on one platform: the text is LLVM's for it, and calls no Python."""

    def initialize_options(self) -> None:
        """Set the options as they are unless others are given: this platform, of which its metadata say that it is one."""
        super().initialize_options()
        self.plat_name = sysconfig.get_platform()
        self.distribution.has_ext_modules = lambda: True  # else setuptools takes its modules for those of any platform

    def get_tag(self) -> tuple[str, str, str]:
        """Return the tag: it calls no Python, so that any Python 3 will do."""
        return "py3", "none", super().get_tag()[2]


class SourceDistribution(sdist):
    """A source distribution from which the tests run."""

    def make_distribution(self) -> None:
        """Pack tests, data and pipelines too."""
        for folder in FOLDERS:
            self.filelist.graft(folder)
        self.filelist.global_exclude("*.py[cod]")
        super().make_distribution()
