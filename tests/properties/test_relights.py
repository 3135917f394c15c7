"""What holds of every relight, whatever the scene, the light and the options."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from properties.scenes import (
    FEW,
    PLAIN,
    SEEDS,
    SIDES,
    blob,
    far_from,
    mirrored,
    mirrored_array,
    options,
    scene_of,
)
from spotlight_runtime import GuidingShadow, Relighter
from spotlight_runtime.diffusion.conditioning import masked_region
from spotlight_runtime.imaging.colour import linear_to_srgb, srgb_to_linear
from spotlight_runtime.relighting import preparation
from spotlight_runtime.relighting.composite import compose_picture

PICTURES = ("image", "prediction", "no_shadow")
MIRROR_TOLERANCE = 2e-5
"""On values in [0, 1]: sums over mirrored patches, blurs and fits run in another order, and five
steps at γ = 15 magnify what float32 leaves."""


def same_bytes(a, b):
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in PICTURES)


def shadows_of(scene, seed, count=2):
    rng = np.random.default_rng([seed, 1])
    return [blob(*scene.size, rng) for _ in range(count)]


@FEW
@given(
    st.integers(1, 60),
    st.integers(1, 60),
    SEEDS,
    st.integers(1, 3),
    options(),
    st.sampled_from(["renderer", "maps"]),
)
def test_background_out_of_reach_is_the_same_bit_for_bit(
    onnx_relighter, height, width, seed, lights, chosen, detail
):
    scene = scene_of(height, width, seed)
    guides = [GuidingShadow(s, weight=0.5 + i) for i, s in enumerate(shadows_of(scene, seed, 3))]
    result = onnx_relighter.relight(scene, guides[:lights], options=replace(chosen, detail=detail))
    shadow = np.max([guide.positive for guide in guides[:lights]], axis=0)
    far = far_from(masked_region(shadow * (1.0 - scene.object_mask), scene.object_mask))
    assert result.image[far].tobytes() == linear_to_srgb(scene.background)[far].tobytes()
    assert np.isfinite(result.image).all()
    assert 0.0 <= result.image.min() <= result.image.max() <= 1.0


@FEW
@given(st.integers(97, 160), st.integers(97, 160), SEEDS)
def test_so_is_what_lies_outside_the_window_of_a_large_photograph(
    onnx_relighter, height, width, seed
):
    scene = scene_of(height, width, seed)
    (shadow,) = shadows_of(scene, seed, 1)
    result = onnx_relighter.relight(scene, shadow, options=replace(PLAIN, steps=1))
    assert not result.window.native
    far = far_from(masked_region(shadow * (1.0 - scene.object_mask), scene.object_mask))
    assert result.image[far].tobytes() == linear_to_srgb(scene.background)[far].tobytes()


@FEW
@given(SIDES, SIDES, SEEDS, options(gamma=1.0), st.sampled_from(["paper", "release"]))
def test_gamma_one_does_not_know_the_negative(
    onnx_relighter, height, width, seed, chosen, fidelity
):
    """Bit for bit, planned (no negative branch is run) or not (it is run, and counts nothing)."""
    scene, chosen = scene_of(height, width, seed), replace(chosen, fidelity=fidelity)
    assume(chosen.guidance_rescale == 0.0)
    shadow, negative = shadows_of(scene, seed)
    with_one, with_none = (
        onnx_relighter.relight(scene, shadow, other, chosen) for other in (negative, None)
    )
    assert same_bytes(with_one, with_none)


@FEW
@given(SIDES, SIDES, SEEDS, options(), st.permutations(range(3)), st.booleans())
def test_order_of_lights_does_not_matter(
    onnx_relighter, height, width, seed, chosen, order, one_casts_nothing
):
    """Bit for bit: the sum over lights has an order of its own."""
    scene = scene_of(height, width, seed)
    rng = np.random.default_rng(seed)
    guides = [
        GuidingShadow(shadow, weight=rng.uniform(0.1, 3), colour=tuple(rng.uniform(0.1, 1, 3)))
        for shadow in shadows_of(scene, seed, 3)
    ]
    if one_casts_nothing:  # its pass then serves as the pass without shadow, or not
        guides[0] = replace(guides[0], positive=np.zeros_like(scene.object_mask))
    listed = onnx_relighter.relight(scene, guides, options=chosen)
    permuted = onnx_relighter.relight(scene, [guides[i] for i in order], options=chosen)
    assert same_bytes(listed, permuted)


@FEW
@given(SIDES, SIDES, SEEDS, st.floats(-6.0, 6.0), options())
def test_brightness_of_all_lights_together_does_not_matter(
    onnx_relighter, height, width, seed, power, chosen
):
    scene, factor = scene_of(height, width, seed), 10.0**power
    guides = [GuidingShadow(s, weight=1.0 + i) for i, s in enumerate(shadows_of(scene, seed))]
    scaled = [replace(guide, weight=guide.weight * factor) for guide in guides]
    a, b = (onnx_relighter.relight(scene, each, options=chosen) for each in (guides, scaled))
    np.testing.assert_allclose(a.image, b.image, atol=1e-6)


@FEW
@given(SIDES, SIDES, SEEDS, st.floats(-3.0, 3.0), st.floats(-2.0, 5.0))
def test_unit_of_the_objects_depth_does_not_matter(
    onnx_relighter, height, width, seed, power, offset
):
    """Where it stands is known by its contact, so its own scale and zero drop out of the fit."""
    scene = scene_of(height, width, seed)
    foot = scene.footprint_depth > 0.0
    # A background that slopes with the contact, as a floor does.
    floor = np.where(foot, 1.5 * scene.footprint_depth + 1.0, scene.background_maps.depth)
    assume(len(np.unique(scene.footprint_depth[foot])) > 2)
    scene = replace(scene, background_maps=replace(scene.background_maps, depth=floor))
    scale, shift = np.float32(10.0**power), np.float32(10.0**power * (2.0 + offset))
    cover = scene.object_mask
    other = replace(
        scene,
        object_maps=replace(
            scene.object_maps, depth=scale * scene.object_maps.depth + shift * cover
        ),
        footprint_depth=np.where(foot, scale * scene.footprint_depth + shift, 0.0).astype("f4"),
    )
    (shadow,) = shadows_of(scene, seed, 1)
    a, b = (onnx_relighter.relight(each, shadow, options=PLAIN) for each in (scene, other))
    # Depths near each other lose digits to the shift: eight bits of float32's 24 at most here. The
    # pictures are the renderer's: where one is nearly black, their ratio magnifies what differs.
    np.testing.assert_allclose(a.prediction, b.prediction, atol=2e-4)
    np.testing.assert_allclose(a.no_shadow, b.no_shadow, atol=2e-4)


def in_the_mirror(monkeypatch, axis):
    """The runtime draws the mirror image of its noise."""
    drawn = preparation.gaussian

    def turned(seed, stream, shape, index=0):
        return mirrored_array(drawn(seed, stream, shape, index), axis - 2)

    monkeypatch.setattr(preparation, "gaussian", turned)


@pytest.mark.parametrize("axis", [0, 1], ids=["upside down", "left for right"])
@FEW
@given(SIDES, SIDES, SEEDS, options(), st.sampled_from(["paper", "release"]))
def test_scene_in_the_mirror_gives_the_picture_in_the_mirror(
    mirror_relighter, axis, height, width, seed, chosen, fidelity
):
    scene, chosen = scene_of(height, width, seed), replace(chosen, fidelity=fidelity)
    shadow, negative = shadows_of(scene, seed)
    straight = mirror_relighter.relight(scene, shadow, negative, chosen)
    turned = [mirrored_array(each, axis) for each in (shadow, negative)]
    with pytest.MonkeyPatch.context() as patch:
        in_the_mirror(patch, axis)
        reflected = mirror_relighter.relight(mirrored(scene, axis), *turned, chosen)
    for name in PICTURES:
        back = mirrored_array(getattr(reflected, name), axis)
        np.testing.assert_allclose(back, getattr(straight, name), atol=MIRROR_TOLERANCE)


def test_mirror_test_would_notice_noise_that_is_not_mirrored(mirror_relighter):
    scene = scene_of(32, 48, 5)
    (shadow,) = shadows_of(scene, 5, 1)
    straight = mirror_relighter.relight(scene, shadow, options=PLAIN)
    turned = mirrored_array(shadow, 1)
    reflected = mirror_relighter.relight(mirrored(scene, 1), turned, options=PLAIN)
    assert np.abs(mirrored_array(reflected.image, 1) - straight.image).max() > 0.01


def test_mirror_test_would_notice_a_backbone_that_knows_left_and_right(onnx_relighter):
    scene = scene_of(32, 48, 5)
    (shadow,) = shadows_of(scene, 5, 1)
    straight = onnx_relighter.relight(scene, shadow, options=PLAIN)
    with pytest.MonkeyPatch.context() as patch:
        in_the_mirror(patch, 1)
        turned = mirrored_array(shadow, 1)
        reflected = onnx_relighter.relight(mirrored(scene, 1), turned, options=PLAIN)
    assert np.abs(mirrored_array(reflected.image, 1) - straight.image).max() > 0.01


@FEW
@given(SIDES, SIDES, SEEDS, st.floats(0.2, 1.0), options(beta=0.0))
def test_darker_photograph_gives_a_darker_picture_by_the_same_factor(
    shadeless_relighter, height, width, seed, factor, chosen
):
    """Of a renderer that does not look at its brightness: all that is left is linear in it."""
    scene = scene_of(height, width, seed)
    darker = replace(scene, background=np.float32(factor) * scene.background)
    (shadow,) = shadows_of(scene, seed, 1)
    bright, dark = (
        shadeless_relighter.relight(each, shadow, options=chosen) for each in (scene, darker)
    )
    assert same_bytes(replace(bright, image=dark.image), dark), "the renderer sees no difference"
    lit, dim = (srgb_to_linear(result.image) for result in (bright, dark))
    below = (lit < 0.999).all(axis=2)  # what was cut off at white is darker than it should be
    np.testing.assert_allclose(dim[below], factor * lit[below], rtol=2e-4, atol=1e-5)


@FEW
@given(SIDES, SIDES, SEEDS, st.floats(0.1, 1.0))
def test_composite_is_linear_in_the_background(height, width, seed, factor):
    rng = np.random.default_rng(seed)
    background, predicted, plain = rng.uniform(0.05, 0.6, (3, height, width, 3)).astype(np.float32)
    mask, shadow = blob(height, width, rng), blob(height, width, rng)
    (a, kept), (b, kept_too) = (
        compose_picture(np.float32(f) * background, predicted, plain, mask, shadow > 0.1)
        for f in (1.0, factor)
    )
    below = a < 1.0
    np.testing.assert_allclose(b[below], factor * a[below], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(kept, kept_too)


def test_relighter_of_plain_functions_draws_nothing_of_its_own(mirror_relighter):
    """Same seed, same bytes, also of another `Relighter` of the same functions."""
    scene = scene_of(24, 32, 1)
    (shadow,) = shadows_of(scene, 1, 1)
    again = Relighter(mirror_relighter.spec, mirror_relighter._networks, remember=0)
    a, b = (each.relight(scene, shadow, options=PLAIN) for each in (mirror_relighter, again))
    assert same_bytes(a, b)
