"""The surface model.

Lambert under GGX with the metallic-roughness parameters of glTF, on Dr.Jit arrays.

It is written out instead of using the renderer's own, because one path serves many lights here: the
texture is looked up once a vertex and the model evaluated for every light. Directions are in the
local frame, z along the normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

DIELECTRIC_F0 = 0.04


@dataclass
class Surface:
    """What a vertex is made of: base colour (linear), GGX alpha (roughness squared), metalness."""

    base: Any
    alpha: Any
    metallic: Any

    @staticmethod
    def lookup(atlas: Any, uv: Any) -> Surface:
        """Read a surface from the atlas texture at uv."""
        red, green, blue, roughness, metallic = atlas.eval(uv)
        return Surface(mi.Color3f(red, green, blue), dr.square(roughness), metallic)


def evaluate(surface: Surface, wi: Any, wo: Any) -> tuple[Any, Any]:
    """Return BSDF times cosine and the density of `sample` for two local directions."""
    active = (wi.z > 0) & (wo.z > 0)
    cos_i, cos_o = dr.maximum(wi.z, 1e-4), dr.maximum(wo.z, 1e-4)
    half = dr.normalize(wi + wo)
    fresnel = _fresnel(surface, dr.dot(wo, half))
    alpha2 = dr.square(surface.alpha)
    distribution = _ggx(half.z, alpha2)
    lambda_i, lambda_o = _lambda(cos_i, alpha2), _lambda(cos_o, alpha2)
    specular = fresnel * (distribution / ((1 + lambda_i + lambda_o) * 4 * cos_i))
    diffuse = (1 - fresnel) * surface.base * ((1 - surface.metallic) * cos_o * dr.inv_pi)
    share = specular_share(surface, cos_i)
    density = share * distribution / ((1 + lambda_i) * 4 * cos_i) + (1 - share) * cos_o * dr.inv_pi
    return dr.select(active, specular + diffuse, 0), dr.select(active, density, 0)


def sample(surface: Surface, wi: Any, choice: Any, point: Any) -> tuple[Any, Any, Any]:
    """Draw a local direction.

    Return it, the throughput factor (BSDF times cosine over density) and the density.

    `choice` is uniform in [0, 1), `point` a uniform Point2f.
    """
    share = specular_share(surface, dr.maximum(wi.z, 1e-4))
    half = _visible_normal(wi, surface.alpha, point)
    mirrored = 2 * dr.dot(wi, half) * half - wi
    wo = dr.select(choice < share, mirrored, mi.warp.square_to_cosine_hemisphere(point))
    value, density = evaluate(surface, wi, wo)
    return wo, dr.select(density > 1e-7, value / dr.maximum(density, 1e-7), 0), density


def specular_share(surface: Surface, cos_i: Any) -> Any:
    """Return the probability that `sample` follows the specular lobe."""
    shine = mi.luminance(_fresnel(surface, cos_i))
    matt = mi.luminance(surface.base) * (1 - surface.metallic)
    share = dr.clip(shine / dr.maximum(shine + matt, 1e-6), 0.1, 0.9)
    return dr.select(surface.metallic > 0.99, 1.0, share)


def _fresnel(surface: Surface, cosine: Any) -> Any:
    f0 = dr.lerp(mi.Color3f(DIELECTRIC_F0), surface.base, surface.metallic)
    c = dr.clip(1 - cosine, 0, 1)
    return f0 + (1 - f0) * (dr.square(dr.square(c)) * c)


def _ggx(cosine: Any, alpha2: Any) -> Any:
    root = dr.square(cosine) * (alpha2 - 1) + 1
    return alpha2 * dr.inv_pi / dr.maximum(dr.square(root), 1e-9)


def _lambda(cosine: Any, alpha2: Any) -> Any:
    tangent2 = (1 - dr.square(cosine)) / dr.square(cosine)
    return 0.5 * (dr.sqrt(1 + alpha2 * tangent2) - 1)


def _visible_normal(wi: Any, alpha: Any, point: Any) -> Any:
    """Draw a visible microfacet normal by spherical caps (Dupuy and Benyoub 2023)."""
    stretched = dr.normalize(mi.Vector3f(wi.x * alpha, wi.y * alpha, dr.maximum(wi.z, 1e-4)))
    z = 1 - point.x * (1 + stretched.z)
    ring = dr.sqrt(dr.maximum(1 - dr.square(z), 0))
    sine, cosine = dr.sincos(2 * dr.pi * point.y)
    half = mi.Vector3f(ring * cosine, ring * sine, z) + stretched
    return dr.normalize(mi.Vector3f(half.x * alpha, half.y * alpha, dr.maximum(half.z, 1e-6)))
