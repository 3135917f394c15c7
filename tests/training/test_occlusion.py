"""Candidate shadows fall where geometry says, and the light is found by them."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the training extra")

from torch.nn import functional  # noqa: E402

from spotlight_training.networks.condition import VIEW, places  # noqa: E402
from spotlight_training.networks.finder import LightFinder  # noqa: E402
from spotlight_training.networks.harmonics import (  # noqa: E402
    HARMONICS,
    harmonics,
    lambertian,
)
from spotlight_training.networks.occlusion import (  # noqa: E402
    DIRECTIONS,
    directions,
    occlusion,
)
from spotlight_training.objectives import coming_from  # noqa: E402

SIDE = 32
FLOOR, TOP = -0.3, 0.15
BOX = ((-0.12, 0.12), (FLOOR, TOP), (0.95, 1.2))
"""A box on a floor, in camera space: right, up, away."""


def box_hit(origin, towards):
    """Distance along rays to the box; infinite where they miss it (slab method)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = -np.inf, np.inf
        for axis, (low, high) in enumerate(BOX):
            a = (low - origin[..., axis]) / towards[..., axis]
            b = (high - origin[..., axis]) / towards[..., axis]
            near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
    return np.where((near <= far) & (far > 1e-6), np.maximum(near, 0.0), np.inf)


@pytest.fixture(scope="module")
def scene():
    """Depth and normals of box, floor and a wall behind, and the box's pixels, at latent size."""
    across = ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * VIEW
    right, down = np.meshgrid(across, across)
    rays = np.stack([right, -down, np.ones_like(right)], axis=-1)
    wall = 2.0
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 1] < 0, FLOOR / rays[..., 1], np.inf)
    box = box_hit(np.zeros(3), rays)
    depth = np.minimum(np.minimum(floor, wall), box)
    points = rays * depth[..., None]
    seen = box < np.minimum(floor, wall)
    normal = np.zeros((SIDE, SIDE, 3))
    normal[..., 1] = floor < wall
    normal[..., 2] = (floor >= wall) | seen
    normal[seen] = [0, 0, 1]
    return depth, seen, points, normal


def candidates(scene, towards):
    depth, box, _, normal = scene
    place, extent = places(torch.from_numpy(depth)[None, None].float())
    hidden = torch.from_numpy(box)[None, None].float()
    upright = torch.from_numpy(normal.transpose(2, 0, 1).copy())[None].float()
    return [
        part[0].numpy()
        for part in occlusion(place, upright, hidden, extent, torch.as_tensor(towards).float())
    ]


def test_candidates_are_spread_over_all_that_is_above():
    towards = directions()
    np.testing.assert_allclose(towards.norm(dim=1), 1.0, atol=1e-3)
    between = towards @ towards.T - 2 * torch.eye(DIRECTIONS)
    nearest = torch.rad2deg(torch.acos(between.amax(dim=1)))
    assert nearest.min() > 15
    assert nearest.max() < 30
    assert towards[:, 1].min() > -0.4


@pytest.mark.parametrize("azimuth", [-120, -60, 60, 120])
def test_shadows_fall_where_rays_meet_the_object(scene, azimuth):
    elevation, azimuth = np.radians(40), np.radians(azimuth)
    towards = np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ]
    )
    _, box, points, _ = scene
    true = np.isfinite(box_hit(points, np.broadcast_to(towards, points.shape))) & ~box
    true = true.reshape(SIDE // 2, 2, SIDE // 2, 2).mean(axis=(1, 3))
    outside = box.reshape(SIDE // 2, 2, SIDE // 2, 2).max(axis=(1, 3)) == 0
    found = candidates(scene, towards[None])[1][0]
    assert true[outside].sum() > 3
    assert np.corrcoef(true[outside], found[outside])[0, 1] > 0.6


def test_only_what_is_hidden_is_the_object(scene):
    by_all, by_hidden = candidates(scene, directions())
    assert (by_hidden <= by_all + 1e-6).all()
    depth, box, points, normal = scene
    _, nothing = candidates((depth, np.zeros_like(box), points, normal), directions())
    assert nothing.max() == 0.0


def test_a_mirrored_scene_has_mirrored_shadows(scene):
    depth, box, points, normal = scene
    shifted = np.roll(box, 3, axis=1)
    towards = directions().numpy()
    one = candidates((depth, shifted, points, normal), towards)
    flipped = (normal * [-1, 1, 1])[:, ::-1].copy()
    mirrored = (depth[:, ::-1].copy(), shifted[:, ::-1].copy(), points, flipped)
    other = candidates(mirrored, towards * np.float32([-1, 1, 1]))
    for a, b in zip(one, other):
        np.testing.assert_allclose(a, b[..., ::-1], atol=1e-3)


def test_any_size_and_no_depth_at_all_are_finite():
    for size in ((3, 5), (1, 1), (9, 4)):
        place, extent = places(torch.zeros(2, 1, *size))
        normal = torch.ones(2, 3, *size)
        found = occlusion(place, normal, torch.ones(2, 1, *size), extent, directions())
        for part in found:
            assert part.shape == (2, DIRECTIONS, -(-size[0] // 2), -(-size[1] // 2))
            assert part.isfinite().all()


def test_light_from_under_a_floor_casts_no_shadow_on_it(scene):
    _, by_hidden = candidates(scene, [[0.3, -0.5, 0.8], [-0.3, -0.9, 0.1]])
    _, box, _, normal = scene
    floor = (normal[..., 1] > 0) & ~box
    only = floor.reshape(SIDE // 2, 2, SIDE // 2, 2).min(axis=(1, 3))
    assert by_hidden[:, only].max() < 0.01


def test_lamps_are_taught_as_directions_near_theirs():
    towards = directions() * torch.tensor([1.0, 1.0, -1.0])
    first = torch.cat([towards[5], torch.tensor([0.75])])
    second = torch.cat([towards[20], torch.tensor([0.25])])
    both = coming_from(torch.stack([first, second])[None])[0]
    assert both.sum() == pytest.approx(1.0, abs=1e-5)
    assert both.argmax() == 5
    assert both[5] == pytest.approx(3 * float(both[20]), rel=0.2)


def test_a_lamp_is_a_clamped_cosine():
    generator = torch.Generator().manual_seed(1)
    normal, towards = (
        functional.normalize(torch.randn(4000, 3, generator=generator)) for _ in range(2)
    )
    made = (harmonics(normal) * lambertian(towards)).sum(dim=1)
    wanted = (normal * towards).sum(dim=1).clamp_min(0.0)
    assert (made - wanted).abs().max() < 0.1
    assert (made - wanted).square().mean().sqrt() < 0.04


def test_light_is_found_under_noise(scene):
    """A few hundred steps teach it to read a direction that no single place gives away."""
    generator = torch.Generator().manual_seed(0)
    blocked = torch.from_numpy(np.concatenate(candidates(scene, directions())))[None]
    cast = torch.nonzero(blocked[0, DIRECTIONS:].sum(dim=(1, 2)) > 4)[:, 0]
    finder = LightFinder(32, 8)
    with torch.no_grad():
        for layer in finder.parameters():
            if layer.dim() > 1:
                layer.copy_(torch.randn(layer.shape, generator=generator) / layer[0].numel() ** 0.5)
    embedding = torch.zeros(16, 8)
    optimiser = torch.optim.Adam(finder.parameters(), 3e-3)

    def drawn():
        chosen = cast[torch.randint(len(cast), (16,), generator=generator)]
        dark = blocked[0, DIRECTIONS + chosen][:, None]
        x = torch.randn(16, 32, *dark.shape[-2:], generator=generator)
        x[:, :8] -= 2.0 * dark
        return x, chosen

    for _ in range(150):
        x, chosen = drawn()
        _, _, found = finder(x, embedding, blocked.expand(16, -1, -1, -1))
        loss = functional.nll_loss(found.likely, chosen)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    towards = directions()
    with torch.no_grad():
        cosines = []
        for _ in range(8):
            x, chosen = drawn()
            told, direct, found = finder(x, embedding, blocked.expand(16, -1, -1, -1))
            cosines.append((towards[found.likely.argmax(dim=1)] * towards[chosen]).sum(dim=1))
    assert told.shape == x.shape
    assert direct.shape == (16, HARMONICS, *x.shape[-2:])
    assert found.shadow.shape == (16, 1, *x.shape[-2:])
    assert torch.cat(cosines).mean() > 0.8  # of 48 candidates; chance is near 0.3
