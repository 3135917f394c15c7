"""The path tracer against closed forms; skipped, with the reason, where it cannot run."""

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the data renderer needs the training packages")
mi = pytest.importorskip("mitsuba", reason="the path tracer needs mitsuba")
pytest.importorskip("pyoidn", reason="the renderer's denoiser needs pyoidn")

from spotlight_training.render.variant import RendererUnavailableError, select_variant  # noqa: E402

try:
    select_variant("auto", threads=1)
except RendererUnavailableError as error:
    pytest.skip(str(error), allow_module_level=True)

import drjit as dr  # noqa: E402

from spotlight_training.render import bsdf  # noqa: E402
from spotlight_training.render.assemble import Geometry  # noqa: E402
from spotlight_training.render.denoise import Denoiser  # noqa: E402
from spotlight_training.render.description import Camera, Light, camera_axes  # noqa: E402
from spotlight_training.render.pipeline import RenderOptions, render, upload  # noqa: E402
from spotlight_training.render.scenes import SceneOptions, describe  # noqa: E402
from spotlight_training.render.sky import floor_radiance, sky_image  # noqa: E402
from spotlight_training.render.solids import ellipsoid  # noqa: E402
from spotlight_training.render.spheres import LightTable  # noqa: E402
from spotlight_training.render.tracer import TraceSettings, trace  # noqa: E402


def soup(parts) -> Geometry:
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    return Geometry(
        np.concatenate([p.vertices for p in parts]).astype(np.float32),
        np.concatenate([p.normals for p in parts]).astype(np.float32),
        np.concatenate([p.uv * 0 for p in parts]).astype(np.float32),
        np.concatenate([p.faces + s for p, s in zip(parts, starts)]).astype(np.uint32),
    )


def plane(half=20.0) -> Geometry:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * half
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    up = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))
    return Geometry(corners, up, np.zeros((4, 2), np.float32), faces)


def light_at(position, radius, target=(0.0, 0.0, 0.0)) -> Light:
    distance = float(np.linalg.norm(np.subtract(position, target)))
    return Light("key", 0.0, 0.0, distance, radius, (1.0, 1.0, 1.0), position)


def flat_atlas(albedo=0.8, roughness=1.0, metallic=0.0):
    values = np.array([albedo] * 3 + [roughness, metallic], np.float32)
    return mi.Texture2f(mi.TensorXf(np.broadcast_to(values, (4, 4, 5)).copy()))


def black_sky():
    return mi.Texture2f(mi.TensorXf(np.zeros((4, 8, 3), np.float32)))


def covered_share(points, lamp, radius, centre, ball):
    """Return the share of a spherical lamp that a ball hides from each point: disc on disc."""
    to_lamp, to_ball = lamp - points, centre - points
    d_lamp, d_ball = np.linalg.norm(to_lamp, axis=-1), np.linalg.norm(to_ball, axis=-1)
    cosine = (to_lamp * to_ball).sum(axis=-1) / d_lamp / d_ball
    d = np.maximum(np.arccos(np.clip(cosine, -1, 1)), 1e-9)
    a, b = np.arcsin(radius / d_lamp), np.arcsin(ball / d_ball)
    cos_a = np.clip((d * d + a * a - b * b) / (2 * d * a), -1, 1)
    cos_b = np.clip((d * d + b * b - a * a) / (2 * d * b), -1, 1)
    kite = np.sqrt(np.clip((-d + a + b) * (d + a - b) * (d - a + b) * (d + a + b), 0, None)) / 2
    lens = a * a * np.arccos(cos_a) + b * b * np.arccos(cos_b) - kite
    overlap = np.where(
        d >= a + b, 0, np.where(d <= np.abs(a - b), np.pi * np.minimum(a, b) ** 2, lens)
    )
    return overlap / (np.pi * a * a)


def floor_points(camera, side, fine):
    """Return where the plane z = 0 meets rays through a `fine` by `fine` grid in each pixel."""
    right, up, forward = camera_axes(camera)
    steps = (np.arange(side * fine) + 0.5) / (side * fine) * 2 - 1
    x, y = np.meshgrid(steps, -steps)
    half = np.tan(np.deg2rad(camera.fov) / 2)
    rays = forward + half * (x[..., None] * right + y[..., None] * up)
    origin = np.asarray(camera.position)
    return origin - rays * (origin[2] / rays[..., 2:])


def test_true_shadow_of_a_sphere_on_a_plane_matches_the_closed_form():
    centre, ball = np.array([0.0, 0.0, 0.5]), 0.3
    lamp, radius = np.array([2.0, 1.0, 4.0]), 0.25
    empty = mi.load_dict({"type": "scene", "plane": upload("plane", plane())})
    sphere = soup(ellipsoid((ball,) * 3, centre, segments=160))
    occluder = mi.load_dict({"type": "scene", "ball": upload("ball", sphere)})
    camera, side, fine = Camera((0.0, -1.5, 1.5), 55.0, 50.0), 48, 6
    traced = trace(
        empty,
        camera,
        LightTable.load([light_at(tuple(lamp), radius)]),
        flat_atlas(),
        black_sky(),
        TraceSettings(side=side, spp=400, vertices=1),
        occluder=occluder,
    )
    shadow = 1 - traced.shadowed[0] / traced.unshadowed[0]
    exact = covered_share(floor_points(camera, side, fine), lamp, radius, centre, ball)
    expected = exact.reshape(side, fine, side, fine).mean(axis=(1, 3))
    assert (expected > 0.99).any()
    assert ((expected > 0.2) & (expected < 0.8)).sum() > 30
    assert np.abs(shadow - expected).max() < 0.05
    assert np.abs(shadow - expected).mean() < 0.002


def test_a_light_from_the_right_throws_its_shadow_to_the_left():
    empty = mi.load_dict({"type": "scene", "plane": upload("plane", plane())})
    sphere = soup(ellipsoid((0.3, 0.3, 0.3), (0.0, 0.0, 0.3)))
    occluder = mi.load_dict({"type": "scene", "ball": upload("ball", sphere)})
    traced = trace(
        empty,
        Camera((0.0, -2.0, 1.5), 35.0, 50.0),
        LightTable.load([light_at((3.0, 0.0, 3.3), 0.1)]),
        flat_atlas(),
        black_sky(),
        TraceSettings(side=32, spp=16, vertices=1),
        occluder=occluder,
    )
    shadow = 1 - traced.shadowed[0] / traced.unshadowed[0]
    columns = (shadow.sum(axis=0) * np.arange(32)).sum() / shadow.sum()
    assert columns < 14


def test_a_light_gives_a_white_matt_floor_the_radiance_it_promises():
    scene = mi.load_dict({"type": "scene", "plane": upload("plane", plane())})
    camera = Camera((0.0, 0.0, 2.0), 90.0, 20.0)
    traced = trace(
        scene, camera, LightTable.load([light_at((0.0, 0.0, 3.0), 0.1)]), flat_atlas(0.9),
        black_sky(), TraceSettings(side=17, spp=64, vertices=3),
    )  # fmt: skip
    surface = bsdf.Surface(mi.Color3f(0.9), mi.Float(1.0), mi.Float(0.0))
    value, _ = bsdf.evaluate(surface, mi.Vector3f(0, 0, 1), mi.Vector3f(0, 0, 1))
    expected = float(value.x[0]) * np.pi
    assert expected == pytest.approx(0.9, abs=0.05)
    assert traced.lights[0][8, 8, 1] == pytest.approx(expected, rel=0.02)
    assert traced.depth[8, 8] == pytest.approx(2.0, abs=1e-3)
    np.testing.assert_allclose(traced.normal[8, 8], [0, 0, 1], atol=1e-5)


@pytest.mark.parametrize(
    ("roughness", "metallic"), [(0.2, 0.0), (0.5, 0.0), (1.0, 0.0), (0.3, 1.0)]
)
def test_surface_model_samples_what_it_evaluates_and_makes_no_energy(roughness, metallic):
    count = 200_000
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    surface = bsdf.Surface(mi.Color3f(0.9), mi.Float(roughness**2), mi.Float(metallic))
    wi = mi.Vector3f(0.6, 0.0, 0.8)
    _, weight, _ = bsdf.sample(surface, wi, sampler.next_1d(), sampler.next_2d())
    sampled = float(dr.mean(weight.y)[0])
    wo = mi.warp.square_to_uniform_hemisphere(sampler.next_2d())
    value, density = bsdf.evaluate(surface, wi, wo)
    integral = float(dr.mean(value.y)[0]) * 2 * np.pi
    # The directions' density integrates to less than 1 only by what the mirror lobe sends below.
    assert float(dr.mean(density)[0]) * 2 * np.pi < 1.02
    assert sampled == pytest.approx(integral, rel=0.05)
    assert sampled < 1.0


def test_an_open_floor_under_a_sky_reflects_unit_radiance():
    scene = describe("train", 1, SceneOptions(use_hdris=False))
    image = sky_image(scene.ambient, None)
    assert floor_radiance(image) == pytest.approx(1.0)


def test_a_small_scene_renders_whole(tmp_path):
    scene = describe("train", 2, SceneOptions(lights=2, use_hdris=False))
    options = RenderOptions(side=32, spp=4)
    denoiser = Denoiser(threads=1)
    record = render(scene, options, denoiser)
    again = render(scene, options, denoiser)
    denoiser.close()
    for image in (*record.lights.values(), *record.lights_background.values(), record.ambient):
        assert image.shape == (32, 32, 3)
        assert np.isfinite(image).all()
        assert image.mean() > 0.01
    assert 0.01 < record.object.alpha.mean() < 0.6
    seen = record.object.alpha > 0
    np.testing.assert_allclose(np.linalg.norm(record.object.normal[seen], axis=1), 1, atol=1e-4)
    assert (record.object.depth[seen] > 0.3).all()
    assert (record.background.depth > 0.3).all()
    for shadow in record.shadows.values():
        assert shadow.min() >= 0.0
        assert shadow.max() <= 1.0
    # Far from the object the pictures with and without it agree.
    name = next(iter(record.lights))
    quiet = (record.shadows[name] < 0.01) & ~seen
    gap = np.abs(record.lights[name] - record.lights_background[name])[quiet]
    assert np.median(gap) < 0.02
    for one, other in zip(record.lights.values(), again.lights.values()):
        np.testing.assert_allclose(one, other, atol=1e-3)


def test_samples_must_be_a_square_number():
    with pytest.raises(ValueError, match="square number"):
        TraceSettings(spp=15)


def test_an_unknown_variant_is_named():
    with pytest.raises(ValueError, match="got 'metal'"):
        select_variant("metal")
