"""The inverse of a well-conditioned sparse matrix as a polynomial: nothing is factored.

With a few hundred thousand rows a factorisation takes minutes and gigabytes, and each change of the
triangles asks for another. The metric of the steps need not be exact, but must be symmetric,
positive and always the same: so no iteration that stops by itself, which is not even linear.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

ERROR = 0.01  # relative, of the inverse; chosen: the metric only shapes the steps
# A solution may take one product with the matrix for so many rows, else it is factored. Chosen:
# factoring took 5 s at 70,000 rows and minutes at 310,000, a product 4 and 25 ms, and there are
# about 50 solutions for each factorisation.
ROWS_A_PRODUCT = 1500
_APART = 1.01  # greatest over least eigenvalue, at least; chosen: those of the identity are alike


class PolynomialInverse:
    """Chebyshev's polynomial for 1/x between the least and the greatest eigenvalue.

    Source: G. H. Golub, R. S. Varga, Numerische Mathematik 3, 1961; the recurrence is that of
    Y. Saad, "Iterative Methods for Sparse Linear Systems", 2nd ed., algorithm 12.1.

    Parameters
    ----------
    matrix
        (V, V), symmetric.
    least
        A lower bound of its eigenvalues, > 0. The upper one is Gershgorin's.
    error
        Of the inverse, relative, at any eigenvalue.

    Attributes
    ----------
    products
        With the matrix, of one solution.
    """

    def __init__(self, matrix: sp.coo_matrix, least: float, error: float = ERROR) -> None:
        rows = matrix.tocsr()
        greatest = max(float(abs(rows).sum(1).max()), _APART * least)
        self._middle, self._half = (greatest + least) / 2, (greatest - least) / 2
        root = np.sqrt(greatest / least)
        rate = np.log((root + 1) / (root - 1))
        self.products = max(int(np.ceil(np.log(2 / error) / rate)), 1)
        self._matrix = rows

    def __call__(self, b: Tensor) -> Tensor:
        """(V, C) -> (V, C), float64, on the same device."""
        left = np.array(b.detach().cpu().numpy(), dtype=np.float64, order="C")
        ratio = self._middle / self._half
        weight = 1 / ratio
        step = left / self._middle
        x = step.copy()
        for _ in range(self.products - 1):
            left -= self._matrix @ step
            after = 1 / (2 * ratio - weight)
            step *= after * weight
            step += (2 * after / self._half) * left
            weight = after
            x += step
        return torch.from_numpy(x).to(b.device)
