"""Surfaces of a product: metallic-roughness materials and the textures they are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from spotlight_runtime.arrays import FloatArray
from spotlight_runtime.imaging.colour import srgb_to_linear
from spotlight_runtime.imaging.decoding import decode_pixels

__all__ = [
    "Material",
    "Surface",
    "Texture",
    "decode_texture",
    "make_texture",
    "shade",
]


MAX_TEXTURE_SIDE: Final = 2048
"""Pixels; larger textures are shrunk, which a photograph does not show and memory does."""
ROW: Final = 4096
"""`cv2.remap` takes pictures, so points are laid out in rows of this many."""
WHITE: Final = np.float32(1.0 / 65535.0)

Wrap = Literal["repeat", "clamp", "mirror"]


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """An image on a surface.

    Attributes
    ----------
    levels : tuple of ndarray of uint16, shape (H + 2, W + 2, C)
        Linear values in [0, 65535], each level half the size of the one before, and with a border
        of one texel that interpolation across the seam finds.
    wrap : (horizontal, vertical)
        What lies outside the unit square.
    transform : ndarray of float32, shape (2, 3)
        From the vertices' texture coordinates to the image's: u right, v down, in [0, 1].
    uv_set : {0, 1}
        Which of the vertices' texture coordinates.
    """

    levels: tuple[npt.NDArray[np.uint16], ...]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    transform: FloatArray = field(default_factory=lambda: np.eye(2, 3, dtype=np.float32))
    uv_set: int = 0

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the finest level, in texels."""
        return self.levels[0].shape[0] - 2, self.levels[0].shape[1] - 2

    def sample(self, uv: FloatArray, texels: FloatArray) -> FloatArray:
        """Values at texture coordinates, averaged over what a pixel sees.

        Parameters
        ----------
        uv : ndarray of float32, shape (N, 2)
            The vertices' texture coordinates, of this texture's set.
        texels : ndarray of float32, shape (N,)
            Side of the unit square of texture coordinates that a pixel covers.

        Returns
        -------
        ndarray of float32, shape (N, C)
            In [0, 1].
        """
        turn = self.transform[:, :2]
        points = uv @ turn.T + self.transform[:, 2]
        stretch = np.sqrt(abs(float(np.linalg.det(turn))) * np.prod(self.size))
        texels = np.maximum(texels * np.float32(stretch), np.float32(1.0))
        last = len(self.levels) - 1
        level = np.minimum(np.log2(texels) + np.float32(0.5), last).astype(np.uint8)
        lowest, highest = int(level.min(initial=last)), int(level.max(initial=0))
        if lowest >= highest:
            return _bilinear(self.levels[lowest], points, self.wrap)
        values = np.empty((len(points), self.levels[0].shape[2]), dtype=np.float32)
        for index in range(lowest, highest + 1):
            chosen = np.flatnonzero(level == index)
            if not len(chosen):
                continue
            values[chosen] = _bilinear(self.levels[index], points[chosen], self.wrap)
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A metallic-roughness material; textures multiply the factors.

    Attributes
    ----------
    base_colour : (r, g, b, a)
        Linear.
    roughness, metallic : float
    base_texture : Texture, optional
        Linear colour, with alpha where it has four channels.
    surface_texture : Texture, optional
        Roughness in its second channel, metalness in its third.
    normal_texture : Texture, optional
        Tangent space, 0.5 + 0.5·n.
    normal_scale : float
    alpha : {"opaque", "mask", "blend"}
    alpha_cutoff : float
        Below it a masked surface is not there.
    """

    base_colour: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    roughness: float = 0.8
    metallic: float = 0.0
    base_texture: Texture | None = None
    surface_texture: Texture | None = None
    normal_texture: Texture | None = None
    normal_scale: float = 1.0
    alpha: Literal["opaque", "mask", "blend"] = "opaque"
    alpha_cutoff: float = 0.5

    @property
    def uv_sets(self) -> set[int]:
        """Which texture coordinates the material needs."""
        textures = (self.base_texture, self.surface_texture, self.normal_texture)
        return {texture.uv_set for texture in textures if texture is not None}


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What N points of a product are made of; float32, in [0, 1] but for the normals.

    Attributes
    ----------
    albedo : ndarray, shape (N, 3)
        Linear base colour.
    alpha, roughness, metallic : ndarray, shape (N,)
    bump : ndarray, shape (N, 3), or None
        Normal in tangent space: along u, along v's rise, out of the surface.
    """

    albedo: FloatArray
    alpha: FloatArray
    roughness: FloatArray
    metallic: FloatArray
    bump: FloatArray | None


def shade(
    material: Material,
    count: int,
    uv: Mapping[int, FloatArray],
    texels: Mapping[int, FloatArray],
    colours: FloatArray | None,
) -> Surface:
    """Evaluate a material.

    Parameters
    ----------
    material : Material
    count : int
        How many points.
    uv : mapping of int to ndarray of float32, shape (N, 2)
        Texture coordinates, by set, of the sets the material uses.
    texels : mapping of int to ndarray of float32, shape (N,)
        Side of the unit square of texture coordinates that a pixel covers, by set.
    colours : ndarray of float32, shape (N, 4), optional
        Linear vertex colours, which multiply the base colour.
    """

    def look_up(texture: Texture) -> FloatArray:
        return texture.sample(uv[texture.uv_set], texels[texture.uv_set])

    base = np.empty((count, 4), dtype=np.float32)
    base[:] = material.base_colour
    if colours is not None:
        base *= colours
    if material.base_texture is not None:
        values = look_up(material.base_texture)
        base[:, : values.shape[1]] *= values
    alpha = np.ones(count, dtype=np.float32)
    if material.alpha == "mask":
        alpha = (base[:, 3] >= material.alpha_cutoff).astype(np.float32)
    elif material.alpha == "blend":
        alpha = np.clip(base[:, 3], 0.0, 1.0)
    roughness = np.full(count, material.roughness, dtype=np.float32)
    metallic = np.full(count, material.metallic, dtype=np.float32)
    if material.surface_texture is not None:
        values = look_up(material.surface_texture)
        roughness *= values[:, 1]
        metallic *= values[:, 2]
    bump = None
    if material.normal_texture is not None:
        bump = look_up(material.normal_texture)[:, :3] * np.float32(2.0) - np.float32(1.0)
        bump[:, :2] *= np.float32(material.normal_scale)
    return Surface(
        albedo=np.clip(base[:, :3], 0.0, 1.0),
        alpha=alpha,
        roughness=np.clip(roughness, 0.0, 1.0),
        metallic=np.clip(metallic, 0.0, 1.0),
        bump=bump,
    )


def decode_texture(data: bytes, name: str) -> npt.NDArray[Any]:
    """Pixels of an image file, shape (H, W, C) with C in {3, 4}, no larger than they need to be.

    Raises
    ------
    ImageFileError
        If the bytes are no whole image.
    """
    pixels = decode_pixels(data, name)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.shape[2] < 3:
        pixels = pixels[..., [0, 0, 0, 1][: 2 + pixels.shape[2]]]
    while max(pixels.shape[:2]) > MAX_TEXTURE_SIDE:
        half = [max(1, side // 2) for side in pixels.shape[1::-1]]
        pixels = np.asarray(cv2.resize(pixels, half, interpolation=cv2.INTER_AREA))
    return pixels


def make_texture(
    pixels: npt.NDArray[Any],
    *,
    colour: bool,
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat"),
    transform: FloatArray | None = None,
    uv_set: int = 0,
) -> Texture:
    """Build a texture and its coarser levels.

    Parameters
    ----------
    pixels : ndarray of uint8 or uint16, shape (H, W, C)
    colour : bool
        Whether red, green and blue are sRGB-encoded; alpha never is.
    """
    top = np.iinfo(pixels.dtype).max
    table = np.arange(top + 1, dtype=np.float32) / np.float32(top)
    values = np.rint(table * 65535.0).astype(np.uint16)
    curve = np.rint(srgb_to_linear(table) * 65535.0).astype(np.uint16) if colour else values
    level = curve[pixels]
    if colour and pixels.shape[2] == 4:
        level[..., 3] = values[pixels[..., 3]]
    levels = [level]
    while max(levels[-1].shape[:2]) > 1:
        height, width = levels[-1].shape[:2]
        half = (max(1, width // 2), max(1, height // 2))
        level = np.asarray(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA))
        levels.append(level)
    matrix = np.eye(2, 3, dtype=np.float32) if transform is None else transform
    return Texture(tuple(_bordered(level, wrap) for level in levels), wrap, matrix, uv_set)


def _bordered(level: npt.NDArray[np.uint16], wrap: tuple[Wrap, Wrap]) -> npt.NDArray[np.uint16]:
    across, down = (cv2.BORDER_WRAP if w == "repeat" else cv2.BORDER_REPLICATE for w in wrap)
    wide = cv2.copyMakeBorder(level, 0, 0, 1, 1, across)
    return np.asarray(cv2.copyMakeBorder(wide, 1, 1, 0, 0, down))


def _bilinear(
    image: npt.NDArray[np.uint16], points: FloatArray, wrap: tuple[Wrap, Wrap]
) -> FloatArray:
    """Interpolate a bordered level."""
    height, width = image.shape[0] - 2, image.shape[1] - 2
    count = len(points)
    rows = -(-count // ROW)
    across = np.zeros((2, rows * ROW), dtype=np.float32)
    across[0, :count] = _wrapped(points[:, 0], wrap[0]) * np.float32(width) + np.float32(0.5)
    across[1, :count] = _wrapped(points[:, 1], wrap[1]) * np.float32(height) + np.float32(0.5)
    x, y = across.reshape(2, rows, ROW)
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR)
    return values.reshape(rows * ROW, -1)[:count] * WHITE


def _wrapped(coordinate: FloatArray, wrap: Wrap) -> FloatArray:
    """Bring texture coordinates into [0, 1]."""
    if wrap == "clamp":
        return np.clip(coordinate, 0.0, 1.0)
    if wrap == "mirror":
        return np.abs(coordinate - np.float32(2.0) * np.rint(coordinate * np.float32(0.5)))
    return coordinate - np.floor(coordinate)
