"""Photograph + object → scene: everything about a picture but its light."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.backdrop import Backdrop
from spotlight_runtime.composing.contact import footprint_depth, visible_share
from spotlight_runtime.composing.cutout import Cutout, paste_cutout
from spotlight_runtime.composing.gbuffer import GBuffer, render_gbuffer
from spotlight_runtime.composing.posing import Placement, pose_product
from spotlight_runtime.composing.product import Product
from spotlight_runtime.errors import PlacementError
from spotlight_runtime.geometry.mesh import ObjectMesh
from spotlight_runtime.imaging.colour import linear_to_srgb, luma
from spotlight_runtime.scenes.scene import Scene

__all__ = ["compose", "draft"]


LEAST_VISIBLE: Final = 4.0
"""Pixels of the object below which there is nothing to relight."""
DRAFT_SIDE: Final = 1024
DRAFT_LIGHT: Final = np.array([-0.35, 0.75, 0.56], dtype=np.float32)
"""Of the draft: from the upper left, behind the camera."""
DRAFT_AMBIENT: Final = 0.45
DARKEST_PAINT: Final = 0.05
"""Mean albedo below which the draft does not trust it."""


def compose(
    backdrop: Backdrop, item: Product | Cutout, placement: Placement, *, occluded: bool = True
) -> Scene:
    """Put an object into a photograph.

    Parameters
    ----------
    backdrop : Backdrop
    item : Product or Cutout
        A product in model space; a cut-out with maps.
    placement : Placement
    occluded : bool
        Whether what stands nearer in the photograph hides the object.

    Returns
    -------
    Scene
        At the photograph's size, in metres.

    Raises
    ------
    GroundError
        If there is no floor at the point asked for.
    PlacementError
        If the object is outside the picture, behind the camera, hidden, or fills the picture.
    """
    camera, ground = backdrop.photograph.camera, backdrop.ground
    if isinstance(item, Cutout):
        buffer, footprint = paste_cutout(item, placement, camera, ground)
        mesh, name = None, item.picture.name
    else:
        posed = pose_product(item, placement, camera, ground)
        buffer = render_gbuffer(posed, camera)
        footprint = footprint_depth(posed, camera, ground)
        mesh, name = _mesh(posed), item.name
    if occluded:
        _hide(buffer, backdrop)
    _check_coverage(buffer, name)
    return Scene(
        background=backdrop.photograph.radiance,
        background_maps=backdrop.maps,
        object_maps=buffer.maps,
        object_mask=buffer.mask,
        footprint_depth=footprint,
        field_of_view=camera.field_of_view,
        name=f"{backdrop.photograph.name}-{name}",
        object_mesh=mesh,
        ground=ground,
    )


def draft(scene: Scene) -> FloatArray:
    """A quick look at a composed scene: the object under a plain light, without shadow.

    Returns
    -------
    ndarray of float32, shape (h, w, 3)
        sRGB-encoded, the longer side at most `DRAFT_SIDE`.
    """
    height, width = scene.size
    factor = min(1.0, DRAFT_SIDE / max(height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))

    def small(array: FloatArray) -> FloatArray:
        return np.asarray(cv2.resize(array, size, interpolation=cv2.INTER_AREA))

    picture, mask = small(scene.background), small(scene.object_mask)
    albedo = small(scene.object_maps.albedo)
    # As bright as the photograph's surfaces are for their albedo.
    paint = float(luma(small(scene.background_maps.albedo)).mean())
    bright = float(luma(picture).mean()) / max(paint, DARKEST_PAINT)
    light: FloatArray | float = 1.0
    if scene.object_maps.normal is not None:
        direction = DRAFT_LIGHT / np.linalg.norm(DRAFT_LIGHT)
        lit = np.maximum(small(scene.object_maps.normal) @ direction, 0.0)[..., None]
        light = DRAFT_AMBIENT + (2.0 - 2.0 * DRAFT_AMBIENT) * lit
    front = albedo * np.float32(bright) * light
    return linear_to_srgb(front + (np.float32(1.0) - mask[..., None]) * picture)


def _mesh(product: Product) -> ObjectMesh:
    """The triangles alone, without vertices that no face uses."""
    used, faces = np.unique(product.faces, return_inverse=True)
    return ObjectMesh(product.vertices[used], faces.reshape(-1, 3).astype(np.int32))


def _hide(buffer: GBuffer, backdrop: Backdrop) -> None:
    """Take away what something nearer in the photograph hides, in the buffer's own arrays."""
    top, bottom, left, right = buffer.box
    crop = np.s_[top:bottom, left:right]
    behind, own = backdrop.maps.depth, buffer.maps.depth
    if behind is None or own is None or top >= bottom or left >= right:
        return
    camera = backdrop.photograph.camera
    share = visible_share(
        own[crop], buffer.mask[crop], behind[crop], camera, backdrop.ground, buffer.box
    )
    if (share == 1.0).all():
        return
    buffer.mask[crop] *= share
    maps = buffer.maps
    for value in (maps.albedo, maps.normal, maps.depth, maps.roughness, maps.metallic):
        if value is not None:
            value[crop] *= share if value.ndim == 2 else share[..., None]


def _check_coverage(buffer: GBuffer, name: str) -> None:
    top, bottom, left, right = buffer.box
    seen = buffer.mask[top:bottom, left:right]
    if float(seen.sum()) < LEAST_VISIBLE:
        raise PlacementError(
            f"{name}: the object covers {float(seen.sum()):.2g} pixels: it is outside the picture, "
            "too small, or hidden by something nearer; place it elsewhere (--at), make it larger "
            "(--size), or let nothing hide it (--no-occlusion)"
        )
    if seen.shape == buffer.mask.shape and float(seen.min()) >= 0.5:
        raise PlacementError(
            f"{name}: the object covers the whole picture; make it smaller (--size) or place it "
            "further up, which is further away (--at)"
        )
