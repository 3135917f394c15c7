"""Lights from JSON, and shadows from images."""

import json

import numpy as np
import pytest
from support.scenes import make_scene, make_shadow

from spotlight_runtime import GuidingShadow, Light, write_image
from spotlight_runtime.errors import ImageFileError, InvalidInputError
from spotlight_runtime.imaging.images import write_exr_layers
from spotlight_runtime.relighting.lights_file import read_lights
from spotlight_runtime.relighting.shadow_files import (
    read_drawing,
    read_ready_shadow,
    read_shadow,
    ready_shadows,
)


def written(folder, document):
    path = folder / "lights.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


@pytest.fixture
def shadow():
    return make_shadow(make_scene(24, 32))


MASK = np.zeros((24, 32), np.float32)
LIGHTS = [
    {"azimuth": 135, "elevation": 45, "weight": 2, "colour": [1, 0.8, 0.6]},
    {"position": [1, 2, 3], "frame": "camera", "radius": 0.2},
    {"azimuth": 10, "elevation": 20, "distance": None, "radius": 0.27},
]


@pytest.mark.parametrize("wrap", [lambda x: x, lambda x: {"lights": x}], ids=["list", "object"])
def test_lights_by_place(tmp_path, wrap):
    assert read_lights(written(tmp_path, wrap(LIGHTS)), MASK) == [
        Light(azimuth=135.0, elevation=45.0, weight=2.0, colour=(1.0, 0.8, 0.6)),
        Light(position=(1.0, 2.0, 3.0), frame="camera", radius=0.2),
        Light(azimuth=10.0, elevation=20.0, distance=None, radius=0.27),
    ]


def test_lights_by_ready_shadow(tmp_path, shadow):
    write_image(tmp_path / "lamp.png", shadow)
    document = [
        {"shadow": "lamp.png", "weight": 2, "colour": [1, 0, 0]},
        {"shadow": "lamp.png", "negative": "lamp.png"},
    ]
    first, second = read_lights(written(tmp_path, document), MASK)
    assert isinstance(first, GuidingShadow)
    np.testing.assert_allclose(first.positive, shadow, atol=1 / 255)
    assert first.negative is None
    assert (first.weight, first.colour) == (2.0, (1.0, 0.0, 0.0))
    np.testing.assert_array_equal(second.negative, second.positive)


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ("[]", "expected at least one light"),
        ("{", "UTF-8 JSON"),
        ('{"light": []}', "unknown key 'light'"),
        ("[3]", r"lights\[0\]: expected an object"),
        ('[{"azimut": 3, "elevation": 4}]', "unknown key 'azimut'.*A light has azimuth, elevation"),
        ('[{"elevation": 3}]', r"lights\[0\]: light: expected azimuth and elevation"),
        ('[{"azimuth": 3, "elevation": 100}]', "elevation: expected a finite number from -90"),
        ('[{"azimuth": 3, "elevation": 10, "weight": -1}]', "weight"),
        ('[{"shadow": "a.png", "azimuth": 3}]', "unknown key 'azimuth'"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, document, named):
    with pytest.raises(InvalidInputError, match=named):
        read_lights(written(tmp_path, document), MASK)


def test_an_azimuth_alone_is_half_way_up(tmp_path):
    assert read_lights(written(tmp_path, [{"azimuth": 30}]), MASK) == [Light(30.0, 45.0)]


def test_a_shadow_is_read_as_the_option_reads_it(tmp_path, shadow):
    """Of another size it is a drawing, which is cleaned, and may be softened and inverted."""
    mask = make_scene(48, 64).object_mask
    write_image(tmp_path / "drawn.png", shadow)
    write_image(tmp_path / "inked.png", 1 - shadow)
    document = [
        {"shadow": "drawn.png", "weight": 2},
        {"shadow": "inked.png", "negative": "inked.png", "softness": 3, "invert": True},
    ]
    drawn, inked = read_lights(written(tmp_path, document), mask)
    np.testing.assert_array_equal(drawn.positive, read_drawing(tmp_path / "drawn.png", mask))
    wanted = read_drawing(tmp_path / "inked.png", mask, softness=3, invert=True)
    np.testing.assert_array_equal(inked.positive, wanted)
    np.testing.assert_array_equal(inked.negative, wanted)


@pytest.mark.parametrize("size", [(24, 32), (48, 64)])
def test_a_drawing_that_is_none_is_named_with_its_light(tmp_path, size):
    write_image(tmp_path / "empty.png", np.zeros(size, np.float32))
    write_image(tmp_path / "white.png", np.ones(size, np.float32))
    lights = [{"azimuth": 3}, {"shadow": "empty.png"}]
    with pytest.raises(InvalidInputError, match=r"lights\[1\]: empty\.png: .* stands out by 2%"):
        read_lights(written(tmp_path, lights), MASK)
    with pytest.raises(InvalidInputError, match=r"lights\[0\]: white\.png: .*Invert it"):
        read_lights(written(tmp_path, [{"shadow": "white.png"}]), MASK)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(InvalidInputError, match=r"nowhere\.json: cannot be read"):
        read_lights(tmp_path / "nowhere.json", MASK)
    with pytest.raises(ImageFileError, match=r"nowhere\.png"):
        read_lights(written(tmp_path, [{"shadow": "nowhere.png"}]), MASK)


def test_ready_shadows_of_a_published_scene(tmp_path, shadow):
    for name in ("0001", "gt_dir", "0000"):
        write_image(tmp_path / f"shadow_positive_{name}.png", shadow)
    write_image(tmp_path / "shadow_negative_gt_dir.png", shadow[:, ::-1].copy())
    assert ready_shadows(tmp_path) == ["0000", "0001", "gt_dir"]
    ready = read_ready_shadow(tmp_path, "gt_dir")
    np.testing.assert_array_equal(ready.positive[:, ::-1], ready.negative)
    assert read_ready_shadow(tmp_path, "0001").negative is None
    with pytest.raises(InvalidInputError, match="ready shadows here: 0000, 0001, gt_dir"):
        read_ready_shadow(tmp_path, "noon")


def test_no_ready_shadows(tmp_path):
    assert ready_shadows(tmp_path / "scene.zip") == []
    with pytest.raises(InvalidInputError, match="ready shadows here: none"):
        read_ready_shadow(tmp_path, "gt_dir")


def test_an_image_of_the_scenes_size_is_the_shadow(tmp_path, shadow):
    write_image(tmp_path / "left.png", shadow, bits=16)
    mask = np.zeros_like(shadow)
    np.testing.assert_array_equal(
        read_drawing(tmp_path / "left.png", mask), read_shadow(tmp_path / "left.png")
    )


@pytest.mark.parametrize("strength", [0.05, 0.5, 1.0])
def test_a_soft_or_wide_shadow_of_the_scenes_size_stays_as_it_is(tmp_path, shadow, strength):
    wide = np.full_like(shadow, 0.8)
    for soft in (strength * shadow, strength * wide):
        write_image(tmp_path / "soft.exr", soft)
        np.testing.assert_array_equal(read_drawing(tmp_path / "soft.exr", MASK), soft)


@pytest.mark.parametrize("size", [(24, 32), (48, 64)])
def test_a_drawing_on_nothing_counts_by_its_alpha_at_any_size(tmp_path, size):
    shadow = make_shadow(make_scene(*size))
    white = np.ones_like(shadow)
    write_image(tmp_path / "stroke.png", np.dstack([white, white, white, shadow]), bits=16)
    write_exr_layers(tmp_path / "stroke.exr", {"": np.dstack([white, shadow])})
    write_image(tmp_path / "grey.exr", shadow)
    wanted = read_drawing(tmp_path / "grey.exr", MASK)
    for name in ("stroke.png", "stroke.exr"):
        np.testing.assert_allclose(read_drawing(tmp_path / name, MASK), wanted, atol=1e-4)


@pytest.mark.parametrize("size", [(24, 32), (48, 64)])
@pytest.mark.parametrize(
    ("value", "alpha", "said"),
    [
        (0.0, 1.0, "nothing that stands out"),
        (1.0, 0.0, "nothing that stands out"),
        (1, 1, "--invert"),
    ],
)
def test_no_drawing_is_said_at_any_size(tmp_path, size, value, alpha, said):
    pixels = np.full((*size, 4), value, np.float32)
    pixels[..., 3] = alpha
    write_image(tmp_path / "a.png", pixels)
    with pytest.raises(InvalidInputError, match=said):
        read_drawing(tmp_path / "a.png", MASK)


def test_the_shadow_of_a_light_opposite_may_be_unseen(tmp_path):
    write_image(tmp_path / "a.png", MASK)
    assert not read_drawing(tmp_path / "a.png", MASK, blank=True).any()


def test_any_other_is_a_scribble(tmp_path, shadow):
    """Of another size, to be softened, or black on white: cleaned, and cleared of the object."""
    mask = make_scene(48, 64).object_mask
    write_image(tmp_path / "left.png", shadow)
    write_image(tmp_path / "inverted.png", 1 - shadow)
    drawn = read_drawing(tmp_path / "left.png", mask)
    assert drawn.shape == (48, 64)
    assert not drawn[mask == 1].any()
    again = read_drawing(tmp_path / "inverted.png", mask, invert=True)
    np.testing.assert_allclose(drawn, again, atol=0.02)
    small = make_scene(24, 32).object_mask
    soft = read_drawing(tmp_path / "left.png", small, softness=4.0)
    sharp = read_drawing(tmp_path / "left.png", small, softness=0.0)
    assert np.abs(np.diff(soft, axis=1)).max() < np.abs(np.diff(sharp, axis=1)).max()
