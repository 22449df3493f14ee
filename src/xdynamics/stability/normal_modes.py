"""Normal modes of a mass and a stiffness, and the eigenvalues of motions that fall apart into them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.runtime.fork_safety import one_blas_thread

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

MANY = 64  # coordinates from which on a matrix is looked at for bands, and eigenvalues are computed mode by mode
BANDED = 16  # of so many coordinates one is the most that a band may reach to be solved as one
SYMMETRIC = 1e-13  # difference of opposite entries, over the largest, that is round-off
SAME_SHAPES = 1e-10  # damping between two modes, over the fastest rate, that is round-off


@dataclass(frozen=True)
class NormalModes:
    """Solutions of K u = w**2 M u.

    Attributes
    ----------
    squares : ndarray of complex, shape (n,), s-2
        Of frequencies, ascending by their real parts.
    shapes : ndarray, shape (n, n)
        As columns.
    symmetric : bool
        Whether K and M are symmetric, M positive: squares are real then, and shapes orthogonal.
    """

    squares: Complexes
    shapes: Floats
    symmetric: bool

    @classmethod
    def from_matrices(cls, stiffness: Floats, mass: Floats) -> NormalModes:
        """Find them, of a band in time that goes as its width (Anderson and others, LAPACK Users' Guide, section 2.4.4)."""
        from scipy import linalg

        if not len(mass):
            return cls(np.zeros(0, np.complex128), np.zeros((0, 0)), symmetric=True)
        symmetric = bool(np.abs(stiffness - stiffness.T).max() <= SYMMETRIC * np.abs(stiffness).max())
        masses = mass.diagonal()
        if symmetric and len(mass) >= MANY and np.count_nonzero(mass) == np.count_nonzero(masses > 0.0) == len(mass):
            root = np.sqrt(masses)
            with one_blas_thread():
                squares, shapes = _symmetric(stiffness / np.outer(root, root))
            shapes = shapes / root[:, None]
        else:
            symmetric = symmetric and bool(np.linalg.eigvalsh(mass)[0] > 0.0)
            with one_blas_thread():
                squares, shapes = (linalg.eigh if symmetric else linalg.eig)(stiffness, mass)
        order = np.argsort(squares.real, kind="stable")
        return cls(squares[order].astype(np.complex128), shapes[:, order].real, symmetric)

    def eigenvalues(self, jacobian: Floats) -> Complexes:
        """Return the eigenvalues of the Jacobian of (q, v): of single oscillators, where damping has these shapes."""
        modal_damping = self.damping(jacobian)
        if modal_damping is None:
            return np.linalg.eigvals(jacobian).astype(np.complex128)
        half = modal_damping / 2.0
        root = np.sqrt((half * half - self.squares).astype(np.complex128))
        return np.concatenate([-half - root, -half + root])

    def damping(self, jacobian: Floats) -> Floats | None:
        """Return the damping of each mode, s-1; None where it joins them, or there are rates or few coordinates."""
        n = len(self.squares)
        if not self.symmetric or len(jacobian) != 2 * n or n < MANY:
            return None
        rates = -jacobian[n:, n:]
        if not rates.any():
            return np.zeros(n)
        damped = np.linalg.solve(self.shapes, rates @ self.shapes)
        modal_damping: Floats = np.array(damped.diagonal(), dtype=np.float64)
        np.fill_diagonal(damped, 0.0)
        fastest = max(np.abs(self.squares).max() ** 0.5, np.abs(modal_damping).max())
        return modal_damping if np.abs(damped).max() <= SAME_SHAPES * fastest else None


def _symmetric(matrix: Floats) -> Any:
    """Return the pair of eigenvalues and eigenvectors of a symmetric matrix, of which the lower half is read."""
    from scipy import linalg

    rows, columns = np.nonzero(matrix)
    width = int(np.max(rows - columns, initial=0))
    if width == 1:
        return linalg.eigh_tridiagonal(matrix.diagonal(), matrix.diagonal(-1))
    if width * BANDED <= len(matrix):
        bands = np.zeros((width + 1, len(matrix)))
        for i in range(width + 1):
            bands[i, : len(matrix) - i] = matrix.diagonal(-i)
        return linalg.eig_banded(bands, lower=True)
    return linalg.eigh(matrix)
