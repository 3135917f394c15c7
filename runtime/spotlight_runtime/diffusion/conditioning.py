"""From a scene and a guiding shadow to the arrays a branch is conditioned on (method §1 and §2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from spotlight_runtime.arrays import BoolArray, FloatArray
from spotlight_runtime.errors import MissingMapError
from spotlight_runtime.imaging.colour import encode_linear
from spotlight_runtime.scenes.scene import Intrinsics, Scene
from spotlight_spec import BackboneSpec, MapSpec

__all__ = [
    "KnownMaps",
    "align_depth",
    "composite_maps",
    "conditioning_array",
    "dilate",
    "masked_region",
    "over",
    "partial_shading",
    "rough_composite",
    "stack_maps",
]


DERIVED = ("shading", "mask")
"""Maps that depend on what is hidden; the others are the scene's."""
SHADOW_THRESHOLD = 0.1
"""Shading is hidden from the network where the guiding shadow exceeds this."""
BARELY_COVERED = 1e-4
"""Coverage up to which a premultiplied depth is too small a number to divide by it."""


def over(foreground: FloatArray, alpha: FloatArray, background: FloatArray) -> FloatArray:
    """Composite a premultiplied foreground: ``foreground + (1 − alpha)·background``."""
    alpha = alpha if background.ndim == 2 else alpha[..., None]
    return foreground + (np.float32(1.0) - alpha) * background


def dilate(mask: FloatArray) -> FloatArray:
    """Grey dilation by one pixel (3×3)."""
    return np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)), dtype=np.float32)


def masked_region(guiding_shadow: FloatArray, object_mask: FloatArray) -> BoolArray:
    """Where shading is unknown: the shadow, and the object dilated by one pixel.

    Parameters
    ----------
    guiding_shadow, object_mask : ndarray of float32, shape (H, W)
        In [0, 1].

    Returns
    -------
    ndarray of bool, shape (H, W)
    """
    return (guiding_shadow > SHADOW_THRESHOLD) | (dilate(object_mask) > 0.0)


def partial_shading(
    background: FloatArray, albedo: FloatArray, hidden: BoolArray, entry: MapSpec, epsilon: float
) -> FloatArray:
    """Background ÷ albedo where it is known, the fill value where it is hidden.

    Parameters
    ----------
    background : ndarray of float32, shape (H, W, 3)
        Encoded as the backbone's shading wants it.
    albedo : ndarray of float32, shape (H, W, 3)
        Background albedo in [0, 1].
    hidden : ndarray of bool, shape (H, W)
    entry : MapSpec
        Range and fill value of the shading map; the range keeps the quotient finite where albedo
        is 0.
    epsilon : float
        Added to the albedo.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
    """
    # Interpolated maps may dip below 0 by a hair; there the quotient would change sign.
    divisor = np.maximum(albedo, np.float32(0.0)) + np.float32(epsilon)
    with np.errstate(over="ignore"):  # of the brightest radiances; it is clipped
        shading = np.clip(background / divisor, entry.minimum, entry.maximum)
    return np.where(hidden[..., None], np.float32(_fill(entry)), shading)


def align_depth(
    object_depth: FloatArray,
    object_mask: FloatArray,
    background_depth: FloatArray,
    footprint_depth: FloatArray | None = None,
) -> tuple[float, float]:
    """Scale and offset that put the object's depth into the background's units.

    With a footprint, the least-squares fit ``m·d_foot + c ≈ d_bg`` over its pixels; without one,
    the shift that puts the object's nearest depth onto the smallest background depth under the
    mask (an object that covers next to nothing stays where it is). Where the fit has no positive
    slope to give (fewer than two distinct depths, or a background that slopes the other way),
    m = 1 and c is the mean difference.

    Parameters
    ----------
    object_depth : ndarray of float32, shape (H, W)
        Premultiplied by ``object_mask``.
    object_mask, background_depth : ndarray of float32, shape (H, W)
    footprint_depth : ndarray of float32, shape (H, W), optional
        0 where the object does not touch the ground.

    Returns
    -------
    m, c : float
    """
    contact = None if footprint_depth is None else footprint_depth > 0.0
    if contact is not None and contact.any():
        foot = footprint_depth[contact].astype(np.float64)  # type: ignore[index]
        ground = background_depth[contact].astype(np.float64)
        spread = foot - foot.mean()
        variance = float((spread * spread).sum())
        # float32 depths that differ by rounding alone carry no slope.
        if variance > foot.size * (1e-6 * foot.mean()) ** 2:
            slope = float((spread * ground).sum()) / variance
            if slope > 0.0:
                return slope, float(ground.mean() - slope * foot.mean())
        return 1.0, float(ground.mean() - foot.mean())
    covered = object_mask > 0.5
    if not covered.any():
        covered = object_mask > BARELY_COVERED
        if not covered.any():
            return 1.0, 0.0
    nearest = float((object_depth[covered] / object_mask[covered]).min())
    return 1.0, float(background_depth[covered].min()) - nearest


def composite_maps(scene: Scene, names: tuple[str, ...]) -> dict[str, FloatArray]:
    """Composite the object's maps over the background's.

    Parameters
    ----------
    scene : Scene
    names : tuple of str
        Which of albedo, normal, depth, roughness, metallic are needed.

    Returns
    -------
    dict of ndarray of float32, shape (H, W) or (H, W, 3)

    Raises
    ------
    MissingMapError
        If the background or the object lacks one of them.
    """
    composed = {}
    for name in names:
        background = _map(scene.background_maps, name, "background")
        inserted = _map(scene.object_maps, name, "object")
        if name == "depth":
            m, c = align_depth(inserted, scene.object_mask, background, scene.footprint_depth)
            inserted = np.float32(m) * inserted + np.float32(c) * scene.object_mask
        composed[name] = over(inserted, scene.object_mask, background)
    return composed


def conditioning_array(spec: BackboneSpec, scene: Scene, guiding_shadow: FloatArray) -> FloatArray:
    """Conditioning of one branch, channels in the backbone's order and ranges.

    Parameters
    ----------
    spec : BackboneSpec
    scene : Scene
    guiding_shadow : ndarray of float32, shape (H, W)
        In [0, 1], already cleared under the object; zeros for no shadow.

    Returns
    -------
    ndarray of float32, shape (K, H, W)

    Raises
    ------
    MissingMapError
        If the scene lacks a map of the backbone.
    """
    return KnownMaps.of(spec, scene).hiding(guiding_shadow)


@dataclass(frozen=True, slots=True, eq=False)
class KnownMaps:
    """What all branches of a view are conditioned on: they differ in what is hidden from them.

    Attributes
    ----------
    spec : BackboneSpec
    planes : ndarray of float32, shape (K, H, W)
        The conditioning with nothing hidden.
    object_mask : ndarray of float32, shape (H, W)
    """

    spec: BackboneSpec
    planes: FloatArray
    object_mask: FloatArray

    @classmethod
    def of(cls, spec: BackboneSpec, scene: Scene) -> KnownMaps:
        """The known maps of a scene; errors are those of `conditioning_array`."""
        maps = composite_maps(scene, tuple(m.name for m in spec.maps if m.name not in DERIVED))
        encoded = encode_linear(scene.background, spec.shading.background_encoding)
        nothing = np.zeros(scene.size, dtype=np.bool_)
        planes = stack_maps(spec, maps, encoded, scene.background_maps.albedo, nothing)
        return cls(spec, planes, scene.object_mask)

    def hiding(self, guiding_shadow: FloatArray) -> FloatArray:
        """Conditioning of a branch; see `conditioning_array`."""
        hidden = masked_region(guiding_shadow, self.object_mask)
        if self.spec.shading.known == "inside":
            hidden = ~hidden
        planes, channels = self.planes.copy(), self.spec.channels
        for entry in self.spec.maps:
            if entry.name in DERIVED:
                np.copyto(planes[channels[entry.name]], np.float32(_fill(entry)), where=hidden)
        return planes


def stack_maps(
    spec: BackboneSpec,
    maps: Mapping[str, FloatArray],
    encoded: FloatArray,
    albedo: FloatArray,
    hidden: BoolArray,
) -> FloatArray:
    """Stack maps in the backbone's order and ranges, with shading hidden in a region.

    Parameters
    ----------
    spec : BackboneSpec
    maps : mapping of str to ndarray of float32, shape (H, W) or (H, W, 3)
        Intrinsic maps by name; normals in [−1, 1].
    encoded, albedo : ndarray of float32, shape (H, W, 3)
        Image and albedo whose quotient is the shading.
    hidden : ndarray of bool, shape (H, W)
        Where the network is not told the shading.

    Returns
    -------
    ndarray of float32, shape (K, H, W)
    """
    planes = []
    for entry in spec.maps:
        if entry.name == "shading":
            plane = partial_shading(encoded, albedo, hidden, entry, spec.shading.epsilon)
        elif entry.name == "mask":
            plane = np.where(hidden, np.float32(_fill(entry)), np.float32(entry.maximum))
        else:
            value = maps[entry.name]
            if entry.name == "normal":
                value = np.float32(0.5) + np.float32(0.5) * value
            plane = np.clip(value, entry.minimum, entry.maximum)
        planes.append(np.atleast_3d(plane).transpose(2, 0, 1))
    return np.ascontiguousarray(np.concatenate(planes), dtype=np.float32)


def rough_composite(
    spec: BackboneSpec, scene: Scene, guiding_shadow: FloatArray, opacity: float = 1.0
) -> FloatArray:
    """g: the object's albedo over the background darkened by the guiding shadow (paper §3.2).

    Made of encoded pixels, as the public release does: the background is encoded and then
    darkened, the albedo enters as the map it is.

    Parameters
    ----------
    spec : BackboneSpec
        Names the encoding.
    scene : Scene
    guiding_shadow : ndarray of float32, shape (H, W)
    opacity : float
        How dark a full shadow is; 1 in the paper.

    Returns
    -------
    ndarray of float32, shape (H, W, 3)
        Encoded image in [0, 1].
    """
    lit = np.float32(1.0) - np.float32(opacity) * guiding_shadow
    background = np.clip(encode_linear(scene.background, spec.image_encoding), 0.0, 1.0)
    g = over(scene.object_maps.albedo, scene.object_mask, background * lit[..., None])
    return np.clip(g, 0.0, 1.0)


def _map(maps: Intrinsics, name: str, owner: str) -> FloatArray:
    value: FloatArray | None = getattr(maps, name, None)
    if value is None:
        raise MissingMapError(
            f"the scene has no {name} map of its {owner}, which this backbone is conditioned on; "
            "add it to the scene, or choose a backbone without it (see `spotlight models`)"
        )
    return value


def _fill(entry: MapSpec) -> float:
    return entry.minimum if entry.fill is None else entry.fill
