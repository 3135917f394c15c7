"""A 2-D cut-out as the object: a picture with a mask, stood upright on the floor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.estimator import estimate_intrinsics
from spotlight_runtime.composing.gbuffer import GBuffer
from spotlight_runtime.composing.photograph import Photograph, read_photograph
from spotlight_runtime.composing.posing import Placement, floor_point
from spotlight_runtime.errors import (
    InvalidInputError,
    MissingMapError,
    PlacementError,
    ProductError,
)
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.imaging.colour import luma
from spotlight_runtime.imaging.images import read_image
from spotlight_runtime.networks.sessions import Network
from spotlight_runtime.scenes.scene import Intrinsics

__all__ = ["Cutout", "estimate_cutout", "paste_cutout", "read_cutout"]


FILL: Final = np.float32(0.2)
"""Linear grey behind a cut-out that comes without its picture: a photograph's middle."""
SOLID: Final = 0.5
"""Coverage from which a pixel counts as the object."""
CONTACT_BAND: Final = 0.03
"""Share of the object's height, from its lowest pixel up, that touches the floor."""
THICKEST: Final = 0.5
"""Share of the object's width that its relief may reach in front of and behind its foot."""
CUTOUT_ROUGHNESS: Final = np.float32(0.7)
"""Of what a picture shows without saying how it shines: matt, as most things are."""
LARGEST_GROWTH: Final = 4
"""Times the photograph's longer side; a larger cut-out is a mistake, and gigabytes."""


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """An object cut out of a picture.

    Attributes
    ----------
    picture : Photograph
        With whatever surrounds the object.
    mask : ndarray of float32, shape (h, w)
        Coverage of the object, in [0, 1].
    maps : Intrinsics, optional
        Of the picture, not premultiplied; depth in any unit.
    """

    picture: Photograph
    mask: FloatArray
    maps: Intrinsics | None = None


def read_cutout(path: str | Path, mask: str | Path | None = None) -> Cutout:
    """Read a cut-out: a picture with alpha, or a picture and a mask.

    Parameters
    ----------
    path : str or Path
    mask : str or Path, optional
        Grey image of the picture's size, white on the object; instead of alpha.

    Raises
    ------
    ProductError
        If there is no mask, it has another size, or it covers nothing or everything.
    ImageFileError
        If a picture cannot be read.
    """
    path = Path(path)
    picture = read_photograph(path)
    if mask is not None:
        pixels = np.clip(np.nan_to_num(read_image(mask)), 0.0, 1.0)
        colour = pixels.ndim == 3 and pixels.shape[2] >= 3
        cover = luma(pixels[..., :3]) if colour else pixels.reshape(*pixels.shape[:2], -1)[..., 0]
        if cover.shape != picture.size:
            raise ProductError(
                f"{mask}: expected a mask of the picture's {picture.size[1]}×{picture.size[0]} "
                f"pixels, got {cover.shape[1]}×{cover.shape[0]}; export it at that size"
            )
    else:
        cover = _alpha(path)
    cover = np.clip(np.nan_to_num(cover), 0.0, 1.0).astype(np.float32)
    source = path if mask is None else mask
    if float(cover.max()) < SOLID:
        raise ProductError(
            f"{source}: the mask covers nothing; paint the object white (or opaque) in it"
        )
    if float(cover.min()) >= SOLID:
        raise ProductError(
            f"{source}: the mask covers everything; paint what is not the object black "
            "(or transparent) in it"
        )
    if mask is None:  # what lies under transparent pixels is anything
        share = cover[..., None]
        picture = replace(picture, radiance=picture.radiance * share + FILL * (1.0 - share))
    return Cutout(picture, cover)


def estimate_cutout(network: Network, cutout: Cutout) -> Cutout:
    """Estimate the cut-out's albedo, normals and depth; see `estimate_intrinsics`."""
    return replace(cutout, maps=estimate_intrinsics(network, cutout.picture))


def paste_cutout(
    cutout: Cutout, placement: Placement, camera: Camera, ground: Ground
) -> tuple[GBuffer, FloatArray]:
    """Stand a cut-out on the floor, upright and facing the camera.

    Parameters
    ----------
    cutout : Cutout
        With maps.
    placement : Placement
        Without yaw. With neither size nor height, its pixels are the photograph's.
    camera : Camera
    ground : Ground
        In metres.

    Returns
    -------
    buffer : GBuffer
        Its maps at the photograph's size, premultiplied.
    footprint : ndarray of float32, shape (H, W)
        Depth of the floor under its lowest pixels, 0 elsewhere.

    Raises
    ------
    MissingMapError
        If the cut-out has no maps.
    InvalidInputError
        If it is to be turned.
    PlacementError
        If it lies outside the picture, or is far larger than it.
    """
    name = cutout.picture.name
    if cutout.maps is None or cutout.maps.normal is None or cutout.maps.depth is None:
        raise MissingMapError(
            f"{name}: expected the cut-out's albedo, normals and depth, got none; give a model "
            "that estimates them (--estimator)"
        )
    if placement.yaw:
        raise InvalidInputError(
            f"{name}: a cut-out cannot be turned, got yaw {placement.yaw:g}; leave the yaw out, "
            "or use a 3-D model"
        )
    inside = cutout.mask >= SOLID
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    crop = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    mask = cutout.mask[crop]
    high, wide = mask.shape
    foot = floor_point(camera, ground, placement.at)
    factor = 1.0
    if placement.height is not None or placement.size is not None:
        metres = placement.height or placement.size or 1.0
        across = high if placement.height is not None else max(high, wide)
        factor = metres * camera.focal / -foot[2] / across
    size = (max(1, round(high * factor)), max(1, round(wide * factor)))
    if max(size) > LARGEST_GROWTH * max(camera.width, camera.height):
        raise PlacementError(
            f"{name}: the cut-out would be {size[1]}×{size[0]} pixels in a photograph of "
            f"{camera.width}×{camera.height}; give a smaller --size or --height"
        )
    relief = _relief(cutout.maps.depth[crop], mask, -foot[2], wide * factor / camera.focal)
    layers = [
        (mask[..., None] * cutout.maps.albedo[crop]),
        (mask[..., None] * cutout.maps.normal[crop]),
        (mask * relief)[..., None],
        mask[..., None],
    ]
    shrinks = factor < 1.0
    kind = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    placed = [cv2.resize(layer, size[::-1], interpolation=kind) for layer in layers]
    bottom = max(1, round(placement.at[1] * camera.height))
    left = round(placement.at[0] * camera.width - 0.5 * size[1])
    buffer = _pasted(placed, (bottom - size[0], left), camera, name)
    return buffer, _footprint(buffer.mask, camera, ground, (bottom, size[0]))


def _alpha(path: Path) -> FloatArray:
    pixels = read_image(path)
    if pixels.ndim != 3 or pixels.shape[2] not in (2, 4):
        raise ProductError(
            f"{path}: expected a cut-out, got a picture without transparency; export it as PNG "
            "with alpha, or give a mask (--mask)"
        )
    return pixels[..., -1]


def _relief(depth: FloatArray, mask: FloatArray, foot: float, width: float) -> FloatArray:
    """Depth in metres around the foot's, from depth in any unit.

    Parameters
    ----------
    depth, mask : ndarray of float32, shape (h, w)
    foot : float
        Depth of the point of contact, metres.
    width : float
        Of the cut-out, as a share of the depth.
    """
    band = mask[-max(1, round(CONTACT_BAND * len(mask))) :] >= SOLID
    reference = float(np.median(depth[-len(band) :][band]))
    relative = np.clip(depth / max(reference, 1e-6), 1.0 - THICKEST * width, 1.0 + THICKEST * width)
    return np.float32(foot) * relative.astype(np.float32)


def _pasted(
    layers: list[FloatArray], corner: tuple[int, int], camera: Camera, name: str
) -> GBuffer:
    """Put albedo, normal, depth and mask into maps of the photograph's size."""
    top, left = corner
    high, wide = layers[3].shape[:2]
    box = (
        max(top, 0),
        min(top + high, camera.height),
        max(left, 0),
        min(left + wide, camera.width),
    )
    if box[0] >= box[1] or box[2] >= box[3]:
        raise PlacementError(f"{name}: the cut-out lies outside the picture; place it elsewhere")
    into = np.s_[box[0] : box[1], box[2] : box[3]]
    out_of = np.s_[box[0] - top : box[1] - top, box[2] - left : box[3] - left]
    full = []
    for layer in layers:
        planes = layer if layer.ndim == 3 else layer[..., None]
        target = np.zeros((camera.height, camera.width, planes.shape[2]), dtype=np.float32)
        target[into] = planes[out_of]
        full.append(target)
    albedo, normal, depth, mask = full
    length = np.linalg.norm(normal[into], axis=2, keepdims=True)
    factor = np.divide(mask[into], length, out=np.zeros_like(length), where=length > 0.0)
    normal[into] *= factor
    mask = mask[..., 0]
    maps = Intrinsics(
        albedo=albedo,
        normal=normal,
        depth=depth[..., 0],
        roughness=mask * CUTOUT_ROUGHNESS,
        metallic=np.zeros_like(mask),
    )
    return GBuffer(maps, mask, box)


def _footprint(
    mask: FloatArray, camera: Camera, ground: Ground, foot: tuple[int, int]
) -> FloatArray:
    """Depth of the floor under the lowest pixels: those in the band above the foot's row."""
    bottom, high = foot
    depth = np.zeros_like(mask)
    top = max(0, bottom - max(1, round(CONTACT_BAND * high)))
    bottom = min(bottom, camera.height)
    row = (0.5 * camera.height - np.arange(top, bottom) - 0.5) / camera.focal
    column = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) / camera.focal
    x, y, z = ground.normal
    falling = x * column[None, :] + y * row[:, None] - z
    floor = ground.offset / np.where(falling < -1e-6, falling, -np.inf)
    depth[top:bottom] = np.where(mask[top:bottom] >= SOLID, floor, 0.0)
    return depth
