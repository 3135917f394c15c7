"""From predictions at the model's scale to light at the photograph's, one layer a light.

The whole photograph, diffused at its own scale, is composed as the paper does
(`spotlight_runtime.relighting.composite`). A window is put back by factors, not pixels: the
shadow's ratio image darkens the photograph, the predicted shading lights the object's
full-resolution albedo, and the full-resolution mask composites one over the other, so nothing that
the photograph knows better is lost. A layer makes its rows when asked for them: a photograph has
twelve million pixels, and memory for one copy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import cv2
import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.diffusion.conditioning import SHADOW_THRESHOLD, dilate, masked_region
from spotlight_runtime.diffusion.sampler import Fidelity
from spotlight_runtime.imaging.colour import decode_to_linear, encode_linear
from spotlight_runtime.imaging.upsampling import GuidedFit, fit_guided
from spotlight_runtime.relighting.canvas import Canvas
from spotlight_runtime.relighting.composite import colour_balance, compose_picture, shadow_ratio
from spotlight_runtime.relighting.object_light import ObjectLight, divided, fit_light, light_rows
from spotlight_runtime.relighting.window import Window
from spotlight_runtime.scenes.scene import Scene
from spotlight_spec import BackboneSpec

__all__ = ["FrameLayer", "Layer", "WindowLayer", "frame_layer", "window_layer"]


SOFT_BORDER: Final = 7
"""Pixels of the photograph beyond object and shadow over which the change fades to none."""
SOFT_SIGMA: Final = 3.0
FULL_CHANGE: Final = 0.3
"""Guiding shadow from which the predicted ratio counts in full; it counts from the threshold of
the shading mask on, and between the two it sets in smoothly, for a photograph shows a step there.
"""
AROUND: Final = 8.0
"""Pixels of the model's scale from which a ratio comes where the prediction itself is of no use."""
GUIDED_TOO: Final = 0.1
"""Guidance, (γ − 1) times the share that the object covers, from which a latent's background is not
believed."""
SHADOW_REACH: Final = 2.0
"""How far shadows are equally deep, in multiples of how far the light on an object is smooth."""
RATIO_RIDGE: Final = 1e-2
"""Keeps slopes small where the guiding shadow hardly varies."""


class Layer(Protocol):
    """A window's relit picture under one light, row by row."""

    def rows(self, top: int, bottom: int) -> tuple[FloatArray, BoolArray]:
        """Rows [top, bottom) of the window.

        Returns
        -------
        linear : ndarray of float32, shape (bottom − top, W, 3)
        untouched : ndarray of bool, shape (bottom − top, W)
            Where the picture is the photograph itself.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FrameLayer:
    """The paper's composite of a whole photograph."""

    linear: FloatArray
    untouched: BoolArray

    def rows(self, top: int, bottom: int) -> tuple[FloatArray, BoolArray]:
        """See `Layer`."""
        return self.linear[top:bottom], self.untouched[top:bottom]


@dataclass(frozen=True, slots=True, eq=False)
class WindowLayer:
    """Factors at the model's scale, fitted to what the photograph's scale knows.

    Attributes
    ----------
    spec : BackboneSpec
    canvas : Canvas
    window : Window
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow at the photograph's scale.
    ratio : GuidedFit
        Ratio image of the encoded background, guided by the guiding shadow.
    light : tuple of ObjectLight
        From the object, linear, by channel; guided by its albedo times normals, and its albedo.
    everywhere : bool
        Whether the ratio counts in the whole window, as in the public release, or in the
        shadow's region only.
    """

    spec: BackboneSpec
    canvas: Canvas
    window: Window
    shadow: FloatArray
    ratio: GuidedFit
    light: tuple[ObjectLight, ...]
    everywhere: bool

    def rows(self, top: int, bottom: int) -> tuple[FloatArray, BoolArray]:
        """See `Layer`."""
        strip = np.s_[top:bottom]
        mask = self.window.crop(self.canvas.mask)[strip]
        background = np.clip(self.window.crop(self.canvas.background)[strip], 0.0, 1.0)
        size = (self.window.height, self.window.width)
        changed = self._changed(top, bottom)
        if changed.any():
            guide = self._shadow_beside_object(top, bottom)[..., None]
            ratio = self.ratio.rows(guide, top, bottom, size, np.ones_like(mask))
            ratio = np.float32(1.0) + changed * (np.clip(ratio, 0.0, 1.0) - np.float32(1.0))
            encoded = encode_linear(background, self.spec.image_encoding) * ratio[..., None]
            background = decode_to_linear(encoded, self.spec.image_encoding)
        covered = np.flatnonzero(mask.any(axis=0))
        if covered.size:
            columns = slice(int(covered[0]), int(covered[-1]) + 1)
            beside = background[:, columns]
            beside *= (np.float32(1.0) - mask[:, columns])[..., None]
            beside += self._object(top, bottom, columns)
        return background, (mask == 0.0) & (changed == 0.0)

    def _object(self, top: int, bottom: int, columns: slice) -> FloatArray:
        """Light from the object in rows [top, bottom) and these columns, linear, premultiplied."""
        mask, albedo, normal = (
            self.window.crop(array)[top:bottom, columns]
            for array in (self.canvas.mask, self.canvas.albedo, self.canvas.normal)
        )
        size = (self.window.height, self.window.width)
        light = light_rows(self.light, albedo, normal, mask, top, bottom, size, columns)
        return np.clip(light, 0.0, mask[..., None])

    def _shadow_beside_object(self, top: int, bottom: int) -> FloatArray:
        """Rows [top, bottom) of the shadow, unattenuated where the object's edge covers some.

        Shadows mostly come cleared under the object, by its coverage. On its edge that would
        leave a bright rim, so there the shadow is what it is next to it.
        """
        first, last = max(top - 1, 0), min(bottom + 1, self.window.height)
        inside = np.s_[top - first : bottom - first]
        shadow = np.ascontiguousarray(self.window.crop(self.shadow)[first:last])
        covered = self.window.crop(self.canvas.mask)[top:bottom] > 0.0
        return np.where(covered, dilate(shadow)[inside], shadow[inside])

    def _changed(self, top: int, bottom: int) -> FloatArray:
        """How far rows [top, bottom) take the predicted ratio, in [0, 1]."""
        if self.everywhere:
            return self._fading_out(top, bottom)
        first, last = (
            max(top - SOFT_BORDER - 1, 0),
            min(bottom + SOFT_BORDER + 1, self.window.height),
        )
        apron = np.s_[first:last]
        mask = self.window.crop(self.canvas.mask)[apron]
        amount = self.window.crop(self.shadow)[apron] - np.float32(SHADOW_THRESHOLD)
        amount = np.clip(amount / np.float32(FULL_CHANGE - SHADOW_THRESHOLD), 0.0, 1.0)
        amount = amount * amount * (np.float32(3.0) - np.float32(2.0) * amount)
        amount[dilate(mask) > 0.0] = 1.0
        side = 2 * SOFT_BORDER + 1
        amount = cv2.GaussianBlur(amount, (side, side), SOFT_SIGMA)
        return np.minimum(amount[top - first : bottom - first], np.float32(1.0))

    def _fading_out(self, top: int, bottom: int) -> FloatArray:
        """One inside the window, fading where it ends and the photograph does not."""
        window, reach = self.window, 4.0 * self.window.scale
        ramps = []
        for start, length, limit in (
            (window.top, window.height, window.frame[0]),
            (window.left, window.width, window.frame[1]),
        ):
            place = np.arange(length)
            before = place / reach if start > 0 else np.ones(length)
            after = (length - 1 - place) / reach if start + length < limit else np.ones(length)
            ramps.append(np.clip(np.minimum(before, after), 0.0, 1.0).astype(np.float32))
        return ramps[0][top:bottom, None] * ramps[1][None, :]


def frame_layer(
    spec: BackboneSpec,
    size: tuple[int, int],
    view: Scene,
    shadow: FloatArray,
    predicted: FloatArray,
    no_shadow: FloatArray,
    fidelity: Fidelity,
) -> FrameLayer:
    """Compose a whole photograph as the paper does.

    Parameters
    ----------
    spec : BackboneSpec
    size : tuple of int
        Height and width of the photograph.
    view : Scene
        What was diffused: the photograph, its border grown to what the VAE takes.
    shadow : ndarray of float32, shape (h, w)
        Guiding shadow of the view, cleared under the object.
    predicted, no_shadow : ndarray of float32, shape (h, w, 3)
        Encoded predictions.
    fidelity : {"paper", "release"}

    Returns
    -------
    FrameLayer
    """
    background = np.clip(encode_linear(view.background, spec.image_encoding), 0.0, 1.0)
    region = masked_region(shadow, view.object_mask) if fidelity == "paper" else None
    image, untouched = compose_picture(background, predicted, no_shadow, view.object_mask, region)
    crop = np.s_[: size[0], : size[1]]
    return FrameLayer(decode_to_linear(image, spec.image_encoding)[crop], untouched[crop])


def window_layer(
    spec: BackboneSpec,
    canvas: Canvas,
    window: Window,
    shadow: FloatArray,
    view: Scene,
    view_shadow: FloatArray,
    predicted: FloatArray,
    no_shadow: FloatArray,
    fidelity: Fidelity,
    gamma: float = 1.0,
) -> WindowLayer:
    """Fit a window's predictions to the photograph's maps.

    Parameters
    ----------
    spec : BackboneSpec
    canvas : Canvas
        The photograph.
    window : Window
    shadow : ndarray of float32, shape (H, W)
        Guiding shadow of the photograph.
    view : Scene
        What was diffused: the window at the model's scale.
    view_shadow : ndarray of float32, shape (h, w)
        Guiding shadow of the view, cleared under the object.
    predicted, no_shadow : ndarray of float32, shape (h, w, 3)
        Encoded predictions.
    fidelity : {"paper", "release"}
    gamma : float
        γ of the prediction.

    Returns
    -------
    WindowLayer
    """
    small = Canvas.of(view).crop(window.size)  # without what was grown for the VAE
    corner = np.s_[: window.size[0], : window.size[1]]
    view_shadow, predicted, no_shadow = view_shadow[corner], predicted[corner], no_shadow[corner]
    mask = small.mask
    encoded = np.clip(encode_linear(small.background, spec.image_encoding), 0.0, 1.0)
    visible = np.float32(1.0) - mask
    guide = divided(view_shadow, visible)[..., None]
    around = np.float32(1.0) - dilate(mask)
    seen = around * around
    values = shadow_ratio(predicted, no_shadow)
    distorted = abs(gamma - 1.0) * _coverage(mask, spec.latent.downscale) > GUIDED_TOO
    ratio = _fit_ratio(values, seen, guide, distorted, SHADOW_REACH * spec.light_reach)
    darkened = ratio.rows(guide, 0, len(mask), mask.shape, np.ones_like(mask))
    behind = encoded * np.clip(darkened, 0.0, 1.0)[..., None]
    balance = colour_balance(encoded, no_shadow, dilate(mask))
    light = decode_to_linear(np.clip(balance * predicted, 0.0, 1.0), spec.image_encoding)
    own = light - visible[..., None] * decode_to_linear(behind, spec.image_encoding)
    return WindowLayer(
        spec=spec,
        canvas=canvas,
        window=window,
        shadow=shadow,
        ratio=ratio,
        light=fit_light(small, np.maximum(own, 0.0), spec.light_reach),
        everywhere=fidelity == "release",
    )


def _fit_ratio(
    values: FloatArray, seen: FloatArray, guide: FloatArray, distorted: BoolArray, reach: float
) -> GuidedFit:
    """The ratio image as a function of the guiding shadow.

    Where pixels are not to be believed one by one (``reach`` above 0), it is one function over so
    many of them, and what is left over is left out. With the mini a reach of 16 pixels brings the
    background 2 dB closer to the truth, and more would bring little: where it is dark is known,
    and only how dark is predicted.

    A latent that object and background share is guided as the object is, and what that makes of the
    background in it, a shadow γ times too dark, is no ratio of anything. There the ratio is what
    its guiding shadow makes it some latents around.
    """
    own = np.where(distorted, np.float32(0.0), seen)
    seen = own if own.any() else seen
    mean = float((seen * values).sum()) / float(seen.sum()) if seen.any() else 1.0
    ridge, usual = (RATIO_RIDGE, 0.0), (0.0, mean)
    if reach:
        return fit_guided(values, seen, guide, ridge=ridge, usual=usual, reach=reach, smooth=True)
    if not distorted.any():
        return fit_guided(values, seen, guide, ridge=ridge, usual=usual)
    around = fit_guided(values, seen, guide, ridge=ridge, usual=usual, reach=AROUND)
    nearby = tuple(np.moveaxis(around.coefficients, 2, 0))
    return fit_guided(values, seen, guide, ridge=ridge, usual=nearby)


def _coverage(mask: FloatArray, downscale: int) -> FloatArray:
    """How much of each pixel's latent the object covers: what guidance counts there."""
    height, width = mask.shape
    cells = cv2.copyMakeBorder(
        mask, 0, -height % downscale, 0, -width % downscale, cv2.BORDER_REPLICATE
    )
    rows, columns = (side // downscale for side in cells.shape)
    share = cells.reshape(rows, downscale, columns, downscale).mean(axis=(1, 3))
    return share.repeat(downscale, axis=0).repeat(downscale, axis=1)[:height, :width]
