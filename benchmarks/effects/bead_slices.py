"""What differs from slice to slice in the stack of a bead: light, place and blur."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, get_args

import torch
from torch import Tensor

from napari_deltamic.errors import InputError
from napari_deltamic.fourier import Band

Disturbance = Literal["brightness", "background", "drift", "focus", "motion", "axial blur"]
# What each moves, in um or um^2, and the standard deviation that it is expected to have: without
# one, a drift of all slices and the place of the bead could not be told apart. Chosen, not
# measured: half a voxel across, half a step of a piezo, a vibration of 0.1 um.
_EXPECTED: dict[str, tuple[tuple[str, ...], float]] = {
    "drift": (("y", "x"), 0.1),
    "focus": (("z",), 0.1),  # chosen
    "motion": (("yy", "xx", "yx"), 0.01),  # chosen
}
_EXPECTED_AXIAL = 0.25  # um^2; chosen: colours half a um apart in focus, not measured

# (Z, Y, X) or (Y, X), and (Z, n): what of it each slice has of n parameters.
Term = tuple[Tensor, Tensor]


class Slices:
    """Stacks whose slices differ, from the spectrum of a bead.

    - ``"brightness"``: of each slice (a lamp that flickers, bleaching);
    - ``"background"``: of each slice, a plane (haze of what lies nearby);
    - ``"drift"``: shift of each slice across (a stage that drifts or tilts);
    - ``"focus"``: where along Z each slice really lies (steps of a piezo are not even);
    - ``"motion"``: variance of the bead's place during the exposure of each slice (vibration);
    - ``"axial blur"``: variance along Z in all slices (the colours of the emission focus at
      different depths).

    Parameters
    ----------
    disturbances
        Those that are free; the others cost nothing.
    band, shape
        Of the spectrum, and of the stack.

    Raises
    ------
    InputError
        If one is not known.
    """

    def __init__(
        self, disturbances: Collection[str], band: Band, shape: tuple[int, int, int]
    ) -> None:
        known = get_args(Disturbance)
        for name in disturbances:
            if name not in known:
                raise InputError(f"unknown disturbance '{name}': choose from {', '.join(known)}")
        self.disturbances = tuple(name for name in known if name in disturbances)
        self.shape = shape
        self.kinds = [
            (kind, _EXPECTED[name][1])
            for name in self.disturbances
            if name in _EXPECTED
            for kind in _EXPECTED[name][0]
        ]
        self.axial = "axial blur" in self.disturbances
        self.count = shape[0] * len(self.kinds) + self.axial
        self._axes = tuple(a.reshape(-1) for a in band.axes())
        self._place_waves(band)
        self._basis()

    def _place_waves(self, band: Band) -> None:
        """Inverse transforms across as matrices: they serve any place of a slice."""
        weights = []
        for axis, (k, n, half) in enumerate(
            zip(self._axes, band.fft_shape, band.half, strict=True)
        ):
            weight = torch.full_like(k, 1 / n)
            whole = 2 * half == n
            if axis == 2:
                weight[1:] *= 2  # those of negative kx
                if whole:
                    weight[-1] /= 2
            elif whole:
                weight[0] /= 2
                weight[-1] /= 2
            weights.append(weight)
        size = band.voxel_size
        waves = []
        for axis in (1, 2):
            at = torch.arange(self.shape[axis], dtype=torch.float64) * size[axis]
            phase = self._axes[axis][:, None] * at
            waves.append(weights[axis][:, None] * torch.complex(torch.cos(phase), torch.sin(phase)))
        self._along_y, self._along_x = waves
        self._weight_z = weights[0]
        self._heights = torch.arange(self.shape[0], dtype=torch.float64) * size[0]

    def _basis(self) -> None:
        """Which slices share each linear parameter."""
        n, y, x = self.shape
        slopes = torch.meshgrid(
            torch.linspace(-1, 1, y, dtype=torch.float64),
            torch.linspace(-1, 1, x, dtype=torch.float64),
            indexing="ij",
        )
        self._each = torch.eye(n, dtype=torch.float64)
        self.all = torch.ones(n, 1, dtype=torch.float64)
        planes = "background" in self.disturbances
        self._fixed = [torch.ones(y, x, dtype=torch.float64), *(slopes if planes else ())]
        background = self._each if planes else self.all
        first = self._each if "brightness" in self.disturbances else self.all
        self._share = [first, *(background for _ in self._fixed)]

    # ---------------------------------------------------------------------------------- images

    def start(self) -> Tensor:
        """(count,) of a stack without disturbances."""
        return torch.zeros(self.count, dtype=torch.float64)

    def expected(self) -> Tensor:
        """(count,) standard deviations around zero."""
        n = self.shape[0]
        found = [torch.full((n,), spread, dtype=torch.float64) for _, spread in self.kinds]
        if self.axial:
            found.append(torch.full((1,), _EXPECTED_AXIAL, dtype=torch.float64))
        return torch.cat(found) if found else self.start()

    def lowest(self) -> Tensor:
        """(count,) lower bounds: variances are not below zero."""
        low = torch.full((self.count,), -torch.inf, dtype=torch.float64)
        each, axial = self._named(low)
        for kind in ("yy", "xx"):
            if kind in each:
                each[kind].zero_()
        if self.axial:
            axial.zero_()
        return low

    def bounded(self, values: Tensor) -> Tensor:
        """Values whose variances are none below zero."""
        each, axial = self._named(values)
        if "yy" in each:
            each["yy"], each["xx"] = each["yy"].clamp(min=0), each["xx"].clamp(min=0)
            most = torch.sqrt(each["yy"] * each["xx"])
            each["yx"] = torch.minimum(torch.maximum(each["yx"], -most), most)
        found = [each[kind] for kind, _ in self.kinds]
        if self.axial:
            found.append(axial.clamp(min=0).reshape(1))
        return torch.cat(found) if found else values

    def _named(self, values: Tensor) -> tuple[dict[str, Tensor], Tensor]:
        n = self.shape[0]
        each = {kind: values[i * n : (i + 1) * n] for i, (kind, _) in enumerate(self.kinds)}
        return each, values[-1] if self.axial else torch.zeros((), dtype=torch.float64)

    def image(self, spectrum: Tensor, values: Tensor) -> Tensor:
        """(Z, Y, X) voxels of the stack."""
        sliced, across = self._sliced(spectrum, values)
        return self._stack(sliced * across)

    def _sliced(self, spectrum: Tensor, values: Tensor, order: int = 0) -> tuple[Tensor, Tensor]:
        """(Z, Ky, Kx) spectra of the slices, derived ``order`` times along Z; their disturbance."""
        each, axial = self._named(values)
        kz, ky, kx = self._axes
        height = self._heights + each["z"] if "z" in each else self._heights
        phase = height[:, None] * kz
        along = torch.complex(torch.cos(phase), torch.sin(phase)) * (1j * kz) ** order
        along = along * (self._weight_z * torch.exp(-0.5 * axial * kz**2))
        sliced = torch.tensordot(along, spectrum, dims=([1], [0]))
        across = torch.ones((1, 1, 1), dtype=torch.complex128)
        if "y" in each:
            shift = ky[:, None] * each["y"][:, None, None] + kx * each["x"][:, None, None]
            across = torch.complex(torch.cos(shift), -torch.sin(shift))
        if "yy" in each:
            powers = self._powers()
            exponent = torch.stack([each[k][:, None, None] * powers[k] for k in powers]).sum(0)
            across = across * torch.exp(-0.5 * exponent)
        return sliced, across

    def _powers(self) -> dict[str, Tensor]:
        _, ky, kx = self._axes
        y, x = ky[:, None], kx[None, :]
        return {"yy": y * y + 0 * x, "xx": x * x + 0 * y, "yx": 2 * y * x}

    def _stack(self, sliced: Tensor) -> Tensor:
        rows = torch.einsum("zyx,yj->zjx", sliced, self._along_y)
        return (rows @ self._along_x).real

    def terms(self, spectrum: Tensor, values: Tensor) -> list[Term]:
        """Derivatives of the image by the values, in their order."""
        sliced, across = self._sliced(spectrum, values)
        whole = sliced * across
        _, ky, kx = self._axes
        factors = {"y": -1j * ky[:, None], "x": -1j * kx[None, :]}
        factors |= {kind: -0.5 * power for kind, power in self._powers().items()}
        found: list[Term] = []
        for kind, _ in self.kinds:
            if kind == "z":
                derived = self._sliced(spectrum, values, 1)[0] * across
            else:
                derived = whole * factors[kind]
            found.append((self._stack(derived), self._each))
        if self.axial:
            derived = self._sliced(spectrum, values, 2)[0] * across
            found.append((0.5 * self._stack(derived), self.all))
        return found

    # ---------------------------------------------------------------------------- linear parts

    def scaled(self, image: Tensor, measured: Tensor, weight: Tensor) -> Tensor:
        """(L,) brightness and background that agree best with what was measured."""
        normal, right = normal_equations(self.linear_terms(image), measured, weight)
        scale = torch.sqrt(torch.diagonal(normal).clamp(min=1e-300))
        inverse = torch.linalg.pinv(normal / (scale[:, None] * scale), hermitian=True)
        return inverse @ (right / scale) / scale

    def applied(self, image: Tensor, linear: Tensor) -> Tensor:
        """The image in the units of the stack."""
        parts = self._parts(linear)
        found = image * parts[0][:, None, None]
        for part, term in zip(parts[1:], self._fixed, strict=True):
            found = found + part[:, None, None] * term
        return found

    def brightness(self, linear: Tensor) -> Tensor:
        """(Z,) of the slices."""
        return self._parts(linear)[0]

    def background(self, linear: Tensor) -> Tensor:
        """(Z,) in the middle of the slices."""
        return self._parts(linear)[1]

    def _parts(self, linear: Tensor) -> list[Tensor]:
        sizes = [s.shape[1] for s in self._share]
        return [s @ v for s, v in zip(self._share, linear.split(sizes), strict=True)]

    def linear_terms(self, image: Tensor) -> list[Term]:
        """Derivatives by the linear parts."""
        return list(zip((image, *self._fixed), self._share, strict=True))

    def described(self, values: Tensor, linear: Tensor) -> dict[str, Tensor]:
        """What was found of each disturbance: um, um^2 for variances; (Z,) or (Z, 2 or 3)."""
        each, axial = self._named(values)
        found: dict[str, Tensor] = {}
        for name in self.disturbances:
            if name == "brightness":
                bright = self.brightness(linear)
                found[name] = bright / bright.mean()
            elif name == "background":
                found[name] = self.background(linear)
            elif name == "axial blur":
                found[name] = torch.sqrt(axial)
            else:
                kinds = _EXPECTED[name][0]
                held = torch.stack([each[k] for k in kinds], -1)
                found[name] = held if len(kinds) > 1 else held[:, 0]
        return found


def normal_equations(terms: list[Term], target: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Of the weighted least squares of a target (Z, Y, X) in the parameters of all terms.

    Slices share no voxel: products are summed within each, and only then go to its parameters.
    """
    root = torch.sqrt(weight).flatten(1)
    flat = torch.stack([t.expand_as(target).flatten(1) * root for t, _ in terms], 1)  # (Z, T, YX)
    gram = flat @ flat.transpose(1, 2)
    seen = (flat @ (target.flatten(1) * root)[:, :, None])[:, :, 0]
    shares = [share for _, share in terms]
    normal = torch.cat(
        [
            torch.cat([a.T @ (gram[:, i, j, None] * b) for j, b in enumerate(shares)], 1)
            for i, a in enumerate(shares)
        ]
    )
    return normal, torch.cat([a.T @ seen[:, i] for i, a in enumerate(shares)])
