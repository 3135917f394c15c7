"""Cut-outs stand where they are put, as large as they are told, with the maps they have."""

from dataclasses import replace

import numpy as np
import pytest
from support.rooms import room

from spotlight_runtime import write_image
from spotlight_runtime.composing.cutout import Cutout, estimate_cutout, paste_cutout, read_cutout
from spotlight_runtime.composing.photograph import Photograph
from spotlight_runtime.composing.posing import Placement, floor_point
from spotlight_runtime.errors import (
    ImageFileError,
    InvalidInputError,
    MissingMapError,
    PlacementError,
    ProductError,
)
from spotlight_runtime.scenes.scene import Intrinsics

BACKDROP = room(240, 180)
CAMERA, GROUND = BACKDROP.photograph.camera, BACKDROP.ground


def disc(size=64, depth=4.0):
    """A disc in the middle of a square picture, bulging towards the camera, with exact maps."""
    rows, columns = np.mgrid[:size, :size] + 0.5
    x, y = columns / size * 2 - 1, 1 - rows / size * 2
    radius = np.hypot(x, y) / 0.8
    mask = np.clip((1.0 - radius) * size * 0.4 + 0.5, 0.0, 1.0).astype(np.float32)
    z = np.sqrt(np.clip(1.0 - radius**2, 0.0, 1.0))
    normal = np.stack([x / 0.8, y / 0.8, z], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    maps = Intrinsics(
        albedo=np.full((size, size, 3), [0.6, 0.4, 0.2], np.float32),
        normal=normal.astype(np.float32),
        depth=(depth - 0.1 * z).astype(np.float32),
    )
    return Cutout(Photograph(np.full((size, size, 3), 0.3, np.float32), name="disc"), mask, maps)


def test_picture_with_alpha_and_picture_with_mask_are_the_same_cutout(tmp_path, rng):
    colour = rng.random((40, 50, 3), dtype=np.float32)
    mask = np.zeros((40, 50), np.float32)
    mask[10:30, 10:40] = 1.0
    write_image(tmp_path / "alpha.png", np.dstack([colour, mask]))
    write_image(tmp_path / "plain.png", colour)
    write_image(tmp_path / "mask.png", mask)
    write_image(tmp_path / "colour-mask.png", np.repeat(mask[..., None], 3, axis=2))
    with_alpha = read_cutout(tmp_path / "alpha.png")
    for name in ("mask.png", "colour-mask.png"):
        with_mask = read_cutout(tmp_path / "plain.png", tmp_path / name)
        np.testing.assert_allclose(with_alpha.mask, with_mask.mask, atol=1e-6)
        inside = mask == 1.0
        np.testing.assert_array_equal(
            with_alpha.picture.radiance[inside], with_mask.picture.radiance[inside]
        )


def test_what_is_under_transparent_pixels_does_not_matter(tmp_path):
    cut = []
    for hidden in (0.0, 1.0):
        pixels = np.full((40, 40, 4), hidden, np.float32)
        pixels[10:30, 10:30] = [0.5, 0.5, 0.5, 1.0]
        pixels[..., 3] = 0.0
        pixels[10:30, 10:30, 3] = 1.0
        write_image(tmp_path / "a.png", pixels)
        cut.append(read_cutout(tmp_path / "a.png").picture.radiance)
    np.testing.assert_array_equal(*cut)


@pytest.mark.parametrize(("value", "said"), [(0.0, "nothing"), (1.0, "everything")])
def test_mask_that_covers_nothing_or_everything(tmp_path, value, said):
    write_image(tmp_path / "p.png", np.full((40, 50, 3), 0.5, np.float32))
    write_image(tmp_path / "m.png", np.full((40, 50), value, np.float32))
    with pytest.raises(ProductError, match=rf"m\.png: the mask covers {said}; paint"):
        read_cutout(tmp_path / "p.png", tmp_path / "m.png")
    write_image(tmp_path / "a.png", np.full((40, 50, 4), value, np.float32))
    with pytest.raises(ProductError, match=rf"a\.png: the mask covers {said}"):
        read_cutout(tmp_path / "a.png")


def test_no_alpha_another_size_or_no_picture(tmp_path):
    write_image(tmp_path / "p.png", np.full((40, 50, 3), 0.5, np.float32))
    with pytest.raises(ProductError, match=r"without transparency.*--mask"):
        read_cutout(tmp_path / "p.png")
    write_image(tmp_path / "m.png", np.ones((40, 40), np.float32))
    with pytest.raises(ProductError, match=r"50×40.*got 40×40"):
        read_cutout(tmp_path / "p.png", tmp_path / "m.png")
    with pytest.raises(ImageFileError):
        read_cutout(tmp_path / "none.png")


@pytest.mark.parametrize("height", [0.5, 1.2])
def test_height_in_metres_at_its_place_on_the_floor(height):
    at = (0.4, 0.75)
    buffer, _ = paste_cutout(disc(), Placement(at, height=height), CAMERA, GROUND)
    solid = buffer.mask >= 0.5
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    foot = floor_point(CAMERA, GROUND, at)
    pixels = height * CAMERA.focal / -foot[2]
    assert len(rows) == pytest.approx(pixels, abs=1.5)
    assert rows[-1] + 1 == pytest.approx(at[1] * 180, abs=1.5)
    assert (columns[0] + columns[-1] + 1) / 2 == pytest.approx(at[0] * 240, abs=1.0)


def test_without_size_its_pixels_are_the_photographs():
    buffer, _ = paste_cutout(disc(40), Placement((0.5, 0.8)), CAMERA, GROUND)
    assert (buffer.mask >= 0.5).sum() == (disc(40).mask >= 0.5).sum()


def test_maps_are_premultiplied_and_in_range():
    buffer, _ = paste_cutout(disc(), Placement((0.5, 0.8), height=0.7), CAMERA, GROUND)
    buffer.maps.check(buffer.mask.shape, "object")
    length = np.linalg.norm(buffer.maps.normal, axis=-1)
    np.testing.assert_allclose(length, buffer.mask, atol=2e-3)
    solid = buffer.mask > 0.99
    np.testing.assert_allclose(
        buffer.maps.albedo[solid], np.broadcast_to([0.6, 0.4, 0.2], (solid.sum(), 3)), atol=1e-2
    )
    assert buffer.maps.albedo[buffer.mask == 0.0].max() == 0.0
    assert buffer.maps.roughness[solid].min() > 0.6
    assert buffer.maps.metallic.max() == 0.0


@pytest.mark.parametrize("unit", [1.0, 40.0])
def test_relief_stands_at_its_foot_whatever_the_unit(unit):
    cutout = disc()
    maps = replace(cutout.maps, depth=cutout.maps.depth * np.float32(unit))
    at = (0.5, 0.8)
    buffer, _ = paste_cutout(replace(cutout, maps=maps), Placement(at, height=0.7), CAMERA, GROUND)
    foot = -floor_point(CAMERA, GROUND, at)[2]
    solid = buffer.mask > 0.99
    depth = buffer.maps.depth[solid] / buffer.mask[solid]
    assert depth.max() == pytest.approx(foot, rel=0.02)
    assert 0.005 * foot < depth.max() - depth.min() < 0.7


def test_footprint_is_floor_under_the_lowest_pixels():
    at = (0.5, 0.8)
    buffer, footprint = paste_cutout(disc(), Placement(at, height=0.7), CAMERA, GROUND)
    touching = footprint > 0.0
    assert 1 <= touching.sum() < 0.2 * (buffer.mask > 0.5).sum()
    np.testing.assert_allclose(footprint[touching], BACKDROP.maps.depth[touching], rtol=1e-3)
    assert np.argwhere(touching)[:, 0].min() > 0.7 * 180


def test_partly_outside_is_cut_off_and_wholly_outside_is_an_error():
    buffer, _ = paste_cutout(disc(), Placement((0.0, 0.8), height=0.7), CAMERA, GROUND)
    whole, _ = paste_cutout(disc(), Placement((0.5, 0.8), height=0.7), CAMERA, GROUND)
    assert buffer.mask.sum() == pytest.approx(0.5 * whole.mask.sum(), rel=0.1)
    assert buffer.box[2] == 0


def test_cutout_far_larger_than_the_photograph():
    with pytest.raises(PlacementError, match=r"disc: the cut-out would be .* smaller --size"):
        paste_cutout(disc(), Placement((0.5, 0.95), height=80.0), CAMERA, GROUND)


def test_cutout_cannot_be_turned_and_needs_maps():
    with pytest.raises(InvalidInputError, match="cannot be turned"):
        paste_cutout(disc(), Placement((0.5, 0.8), yaw=10.0), CAMERA, GROUND)
    with pytest.raises(MissingMapError, match="--estimator"):
        paste_cutout(replace(disc(), maps=None), Placement((0.5, 0.8)), CAMERA, GROUND)


def test_maps_are_estimated_from_its_picture():
    def network(image):
        return {"maps": np.full((1, 7, *image.shape[2:]), 0.5, np.float32)}

    estimated = estimate_cutout(network, replace(disc(), maps=None))
    estimated.maps.check((64, 64), "cut-out")
    paste_cutout(estimated, Placement((0.5, 0.8)), CAMERA, GROUND)
