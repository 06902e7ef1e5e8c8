"""Which layer shows the same scene through another PSF, and how wide that PSF is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from psygnal import Signal

from ..common.triple import Triple, triple
from ..errors import InputError
from ..fitting.job import SIGMA_IN_VOXELS
from ..scene.effects import ViewEffect, kind_of
from .image_source import ImageSource
from .layer_channels import file_of
from .layer_choice import LayerChoice
from .viewing.frame import Frame, is_stack, shape_of, voxel_size


class SecondSource(LayerChoice):
    """Choice of a second view of an image; none but by the user.

    sigma : widths of its PSF, um: as wide as those of most images, until someone says more.
    """

    edited = Signal()  # by the user
    shown = Signal()  # it, or the image, is another one

    def __init__(self, viewer: Any, image: ImageSource) -> None:
        self._image = image
        self.sigma: Triple = (1.0, 1.0, 1.0)
        self._given = self._quiet = False
        super().__init__(viewer, self._can_be_second, optional=True)
        self.changed.connect(self._chosen)
        image.changed.connect(self._image_changed)

    def view(self) -> ViewEffect | None:
        """The effect, or None for no second view.

        Raises
        ------
        InputError
            If the layer does not lie on the voxels of the image.
        """
        layer, image = self.layer, self._image.layer
        if layer is None or image is None:
            return None
        _check_on_voxels(layer, image)
        path, channel = file_of(layer)
        # The file of a second view holds nothing else.
        return kind_of(ViewEffect)(sigma=self.sigma, image="" if channel else path)

    def pixels(self) -> NDArray[Any] | None:
        """(Z, Y, X) of the layer, at the time shown; None for no second view."""
        return None if self.layer is None else self._image.stack(self.layer)

    def show(self, layer: Any, sigma: Triple | None = None) -> None:
        """Take over a choice, which is no edit; None for no second view."""
        self._quiet = True
        if sigma is not None:
            self.sigma, self._given = sigma, True
        self.choose(layer)
        self._quiet = False
        self.shown.emit()

    def resize(self, sigma: Triple) -> None:
        """The user knows how wide its PSF is."""
        self.sigma, self._given = sigma, True
        self.edited.emit()

    def both(self) -> list[Any]:
        """The image and its second view, where there is one."""
        layers = [self.layer, self._image.layer]
        return layers if None not in layers else []

    def _can_be_second(self, layer: Any) -> bool:
        return is_stack(layer) and layer is not self._image.layer

    def _image_changed(self) -> None:
        self.refresh()
        layer = self._image.layer
        if not self._given and layer is not None:
            self.sigma = triple(SIGMA_IN_VOXELS * d for d in voxel_size(layer))
        self.shown.emit()

    def _chosen(self) -> None:
        self.shown.emit()
        if not self._quiet:
            self.edited.emit()


def _check_on_voxels(layer: Any, image: Any) -> None:
    """InputError, with what to do, unless both layers have the same voxels."""
    advice = "register it to the image and resample it on the image's voxels first"
    shape, of_image = shape_of(layer), shape_of(image)
    if shape != of_image:
        mine, theirs = (" x ".join(map(str, s)) for s in (shape, of_image))
        raise InputError(
            f"second view: '{layer.name}' has {mine} voxels, the image {theirs}: {advice}"
        )
    try:
        own, first = Frame.of(layer), Frame.of(image)
    except InputError as error:
        raise InputError(f"second view: {error}: {advice}") from None
    shift = np.abs(first.to_um(own.translate))
    same = np.allclose(own.voxel_size, first.voxel_size, rtol=1e-3)
    if not same or (shift > 0.01 * np.array(first.voxel_size)).any():
        raise InputError(
            f"second view: '{layer.name}' does not lie on the voxels of the image: {advice}, "
            "then give both layers the same scale and translation"
        )
