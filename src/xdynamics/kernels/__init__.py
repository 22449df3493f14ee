"""From a model and a method to compiled functions: arithmetic, source text, the cache on disk."""

from xdynamics.kernels.cache import compile_march, source_digest
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.problem import Problem, pose
from xdynamics.kernels.writer import write_interpolation, write_source

__all__ = ["Layout", "Problem", "compile_march", "pose", "source_digest", "write_interpolation", "write_source"]
