"""Between pictures and latents."""

import numpy as np
import pytest
from support.onnx_backbone import tiny_spec

from spotlight_runtime.errors import NumericalError
from spotlight_runtime.networks.codec import decode_latents, encode_conditioning, encode_image

SPEC = tiny_spec()
SCALE = np.float32(SPEC.latent.scaling_factor)
ZEROS = np.zeros((1, 4, 2, 3), np.float32)


def encoder(mean, std=0.0, seen=None):
    def network(image):
        if seen is not None:
            seen.append(image)
        return {
            "latent_mean": np.full((1, 4, 2, 3), mean, np.float32),
            "latent_std": np.full((1, 4, 2, 3), std, np.float32),
        }

    return {"vae_encoder": network}


def test_image_goes_in_scaled_to_plus_minus_one():
    seen = []
    encoded = np.zeros((16, 24, 3), np.float32)
    encoded[0, 0] = [1.0, 0.5, 0.75]
    encode_image(encoder(0.0, seen=seen), SPEC, encoded)
    (image,) = seen
    assert image.shape == (1, 3, 16, 24)
    assert image.dtype == np.float32
    assert image.flags.c_contiguous
    np.testing.assert_allclose(image[0, :, 0, 0], [1.0, 0.0, 0.5], atol=1e-6)
    assert image[0, :, 1:].max() == -1.0


def test_latents_are_the_scaled_mean():
    got = encode_image(encoder(2.0, 5.0), SPEC, np.zeros((16, 24, 3), np.float32))
    np.testing.assert_array_equal(got, np.full((1, 4, 2, 3), 2.0 * SCALE, np.float32))


def test_sampled_latents_add_the_deviation_before_scaling(rng):
    noise = rng.standard_normal((1, 4, 2, 3), dtype=np.float32)
    got = encode_image(encoder(2.0, 0.5), SPEC, np.zeros((16, 24, 3), np.float32), noise)
    np.testing.assert_allclose(got, (2.0 + 0.5 * noise) * SCALE, rtol=1e-6)


def test_picture_is_unscaled_clipped_and_channels_last():
    seen = []

    def decoder(latents):
        seen.append(latents)
        image = np.zeros((1, 3, 16, 24), np.float32)
        image[0, :, 0, 0] = [-3.0, 0.5, 3.0]
        return {"image": image}

    got = decode_latents({"vae_decoder": decoder}, SPEC, np.full((1, 4, 2, 3), SCALE, np.float32))
    np.testing.assert_allclose(seen[0], 1.0, rtol=1e-6)
    assert got.shape == (16, 24, 3)
    assert got.flags.c_contiguous
    np.testing.assert_allclose(got[0, 0], [0.0, 0.75, 1.0])
    assert (got[1:] == 0.5).all()


def test_conditioning_is_encoded_branch_by_branch(rng):
    maps = rng.random((2, 11, 16, 24), dtype=np.float32)
    sizes = []

    def network(conditioning):
        sizes.append(len(conditioning))
        return {"condition": conditioning[:, :6, ::8, ::8]}

    got = encode_conditioning({"condition_encoder": network}, maps)
    np.testing.assert_array_equal(got, maps[:, :6, ::8, ::8])
    assert sizes == [1, 1]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_names_the_stage(bad):
    with pytest.raises(NumericalError, match="encoding the rough composite: 24 of 24"):
        encode_image(encoder(bad), SPEC, np.zeros((16, 24, 3), np.float32))
    spoiled = np.full((1, 3, 16, 24), bad, np.float32)
    with pytest.raises(NumericalError, match="decoding the latents"):
        decode_latents({"vae_decoder": lambda latents: {"image": spoiled}}, SPEC, ZEROS)
    with pytest.raises(NumericalError, match=r"encoding the conditioning \(branch 0\)"):
        encode_conditioning(
            {"condition_encoder": lambda conditioning: {"condition": spoiled}}, spoiled
        )


@pytest.mark.parametrize("latent", [3e38, np.inf, np.nan])
def test_latents_that_overflow_when_unscaled_never_reach_the_decoder(latent):
    """A decoder that saturates would make a finite picture of them."""
    networks = {"vae_decoder": lambda latents: {"image": np.tanh(latents[:, :3])}}
    with pytest.raises(NumericalError, match="unscaling the latents"):
        decode_latents(networks, SPEC, np.full_like(ZEROS, latent))
