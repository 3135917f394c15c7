"""Where the object touches the floor, and where something in the photograph hides it."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.composing.gbuffer import image_box
from spotlight_runtime.composing.product import Product
from spotlight_runtime.geometry.camera import Camera
from spotlight_runtime.geometry.ground import Ground
from spotlight_runtime.geometry.raycast import Caster

__all__ = ["footprint_depth", "visible_share"]


CONTACT: Final = 0.02
"""What is nearer to the floor than this share of the object's size touches it."""
LEAST_CONTACT: Final = 1e-3
"""Metres; meshes are not modelled more precisely."""
BELOW: Final = 0.01
"""Metres under the floor from which is looked up."""
RISE: Final = 0.03
"""Metres above the floor that something in the photograph has to reach to hide the object: what is
lower may be the floor's own error."""
RISE_SHARE: Final = 0.02
"""The same as a share of the depth, for depth errs in proportion."""
NEARER: Final = 0.05
"""Share of the object's depth by which it has to be nearer."""


def footprint_depth(product: Product, camera: Camera, ground: Ground) -> FloatArray:
    """Depth of the floor where the object stands on it.

    Parameters
    ----------
    product : Product
        In camera space.
    camera : Camera
    ground : Ground

    Returns
    -------
    ndarray of float32, shape (H, W)
        0 where there is no contact.
    """
    depth = np.zeros((camera.height, camera.width), dtype=np.float32)
    used = product.vertices[np.unique(product.faces)]
    up = np.array(ground.normal, dtype=np.float32)
    height = used @ up - np.float32(ground.offset)
    reach = max(CONTACT * float(np.ptp(used, axis=0).max()), LEAST_CONTACT)
    low = used[height <= reach]
    if not len(low):
        return depth
    top, bottom, left, right = image_box(low, camera)
    x, y = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
    if not x.size:
        return depth
    rays = _rays(camera, x, y)
    falling = rays @ up
    floor = falling < -1e-6
    along = np.where(floor, ground.offset / np.where(floor, falling, -1.0), 0.0).astype(np.float32)
    start = rays * along[:, None] - np.float32(BELOW) * up
    hits = Caster(product.vertices, product.faces).cast(start, np.broadcast_to(up, start.shape))
    touching = hits.ray[(hits.distance <= BELOW + reach) & floor[hits.ray]]
    depth[y.reshape(-1)[touching], x.reshape(-1)[touching]] = along[touching]
    if not len(touching):  # thinner than a pixel
        _mark(depth, camera, low[np.argmin(low @ up)])
    return depth


def visible_share(
    object_depth: FloatArray,
    mask: FloatArray,
    background_depth: FloatArray,
    camera: Camera,
    ground: Ground,
    box: tuple[int, int, int, int],
) -> FloatArray:
    """How much of each of the object's pixels nothing in the photograph hides.

    Only what stands on the floor and clearly nearer than the object hides it: the floor itself,
    known to a few per cent, does not cut the object's foot off.

    Parameters
    ----------
    object_depth, mask : ndarray of float32, shape (h, w)
        Of the box; depth premultiplied.
    background_depth : ndarray of float32, shape (h, w)
        Of the box, in metres.
    camera : Camera
    ground : Ground
    box : (top, bottom, left, right)

    Returns
    -------
    ndarray of float32, shape (h, w)
        In [0, 1].
    """
    top, bottom, left, right = box
    x, y = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
    rays = _rays(camera, x, y).reshape(*mask.shape, 3)
    up = np.array(ground.normal, dtype=np.float32)
    height = (rays @ up) * background_depth - np.float32(ground.offset)
    own = np.divide(object_depth, mask, out=np.zeros_like(mask), where=mask > 0.0)
    # One pixel further out, so that the blur below finds no visible rim beside the object.
    own = np.where(mask > 0.0, own, cv2.dilate(own, np.ones((3, 3), np.uint8)))
    standing = height > np.maximum(RISE, RISE_SHARE * background_depth)
    hiding = standing & (background_depth > 0.0) & (background_depth < (1.0 - NEARER) * own)
    if not hiding.any():
        return np.ones_like(mask)
    # Depth has no antialiased edges; one pixel of blur gives the hidden rim one.
    soft = cv2.blur(hiding.astype(np.float32), (3, 3), borderType=cv2.BORDER_REPLICATE)
    return np.clip(np.float32(1.0) - soft, 0.0, 1.0)


def _rays(camera: Camera, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp]) -> FloatArray:
    """Directions through pixels, scaled to reach depth 1, shape (N, 3)."""
    rays = np.full((x.size, 3), -1.0, dtype=np.float32)
    rays[:, 0] = (x.reshape(-1) + 0.5 - 0.5 * camera.width) / camera.focal
    rays[:, 1] = (0.5 * camera.height - y.reshape(-1) - 0.5) / camera.focal
    return rays


def _mark(depth: FloatArray, camera: Camera, point: FloatArray) -> None:
    """Write one point's depth, if it is in the picture."""
    x, y, far = camera.project(point[None])[0]
    row, column = int(np.floor(y)), int(np.floor(x))
    if 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]:
        depth[row, column] = far
