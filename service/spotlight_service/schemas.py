"""What requests look like; the runtime checks the meaning, these check the form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from spotlight_runtime.planning.options import WindowMode
from spotlight_service.plans import PlanName
from spotlight_service.problems import TAG

__all__ = ["MOST_LIGHTS", "PLANNED", "DrawnLight", "PlacedLight", "RelightRequest", "ShadowRequest"]


MOST_LIGHTS: Final = 16
PLANNED: Final = (
    "steps",
    "solver",
    "plain_steps",
    "guidance_interval",
    "reuse",
    "fidelity",
    "window",
    "detail",
)
"""Options that a plan chooses where a request does not."""
SCENE_ID: Final = r"^[0-9a-f]{64}$"
SAMPLE_ID: Final = "0" * 64
PLACED, DRAWN, WORD = (f"{TAG}{name}" for name in ("placed", "drawn", "word"))
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[Finite, Field(ge=0, le=1)]
Interval = tuple[Share, Share]
Colour = Annotated[
    list[Annotated[Finite, Field(ge=0)]],
    Field(
        min_length=3,
        max_length=3,
        description="Linear red, green, blue of this light where several are combined.",
    ),
]
Position = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Weight = Annotated[Finite, Field(ge=0, description="Share of this light among several.")]
Base64Picture = Annotated[
    str,
    Field(
        min_length=1,
        max_length=12_000_000,
        description="A PNG, JPEG or WebP picture in base64 (a canvas's data: URL will do); "
        "white is shadow. Addresses are not fetched.",
    ),
]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class PlacedLight(_Strict):
    """A light by its place, which casts its shadow."""

    azimuth: Finite | None = Field(
        None, description="Degrees round the object: 0 right, 90 behind, 180 left, 270 in front."
    )
    elevation: Finite | None = Field(None, ge=-90, le=90, description="Degrees above the floor.")
    radius: Finite = Field(
        1.0, ge=0, description="Softness: its size, in object sizes; degrees if directional."
    )
    distance: Finite | None = Field(
        10.0, gt=0, description="In object sizes; null for a light infinitely far away."
    )
    position: Position | None = Field(
        None, description="Metres, instead of azimuth, elevation and distance."
    )
    frame: Literal["world", "camera"] = "world"
    weight: Weight = 1.0
    colour: Colour = [1.0, 1.0, 1.0]


class DrawnLight(_Strict):
    """A light by its shadow, drawn or painted."""

    shadow: Base64Picture
    negative: Base64Picture | None = Field(
        None, description="Shadow of the opposite light, likewise; none by default."
    )
    softness: Finite | None = Field(
        None, ge=0, le=1000, description="Pixels over which the drawing's edges fade."
    )
    invert: bool = Field(False, description="The drawing is black on white.")
    weight: Weight = 1.0
    colour: Colour = [1.0, 1.0, 1.0]


def _kind_of_light(entry: Any) -> str | None:
    if isinstance(entry, DrawnLight) or (isinstance(entry, Mapping) and "shadow" in entry):
        return DRAWN
    return PLACED if isinstance(entry, PlacedLight | Mapping) else None


def _kind_of_negative(entry: Any) -> str | None:
    return WORD if isinstance(entry, str) else _kind_of_light(entry) and PLACED


# Chosen before it is looked into: what is wrong with a light is told of its own kind alone.
AnyLight = Annotated[
    Annotated[PlacedLight, Tag(PLACED)] | Annotated[DrawnLight, Tag(DRAWN)],
    Discriminator(
        _kind_of_light,
        custom_error_type="light",
        custom_error_message="a JSON object, of a placed light or with a shadow",
    ),
]
Negative = Annotated[
    Annotated[Literal["opposite", "none"], Tag(WORD)] | Annotated[PlacedLight, Tag(PLACED)],
    Discriminator(
        _kind_of_negative,
        custom_error_type="negative",
        custom_error_message="'opposite', 'none' or a placed light",
    ),
]
Lights = Annotated[list[AnyLight], Field(min_length=1, max_length=MOST_LIGHTS)]
SceneId = Annotated[str, Field(pattern=SCENE_ID, description="As POST /v1/scenes gives it.")]


class ShadowRequest(_Strict):
    """Lights to sketch."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"lights": [{"azimuth": 135, "elevation": 45}]}]},
    )

    lights: Lights
    show: Literal["sketch", "shadow"] = Field(
        "sketch", description="The object in its shadow, or the guiding shadow, white on black."
    )
    side: int = Field(768, ge=64, le=2048, description="Pixels of the longer side; never enlarged.")


class RelightRequest(_Strict):
    """A picture to make."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "scene": SAMPLE_ID,
                    "lights": [{"azimuth": 135, "elevation": 45, "radius": 1.0}],
                    "plan": "exact",
                    "seed": 469,
                }
            ]
        },
    )

    scene: SceneId
    lights: Lights
    negative: Negative | None = Field(
        None, description="What the guidance contrasts with; the opposite light by default."
    )
    sweep: bool = Field(
        False, description="Each light a picture of its own, together on a contact sheet."
    )
    model: str = Field("mini", min_length=1, max_length=200)
    plan: PlanName | None = Field(
        None, description="How much accuracy to trade for time: exact unless there is a budget."
    )
    budget_s: Finite | None = Field(
        None, gt=0, le=86400, description="Instead of a plan: seconds it may take."
    )
    deadline_s: Finite | None = Field(
        None, gt=0, description="Seconds from now until the job is given up."
    )
    gamma: Finite = Field(3.0, ge=0, le=20, description="How strongly the shadow steers shading.")
    beta: Finite = Field(
        0.05, ge=0, le=1, description="How strongly the shadow enters the picture."
    )
    seed: int = Field(469, ge=0, le=2**63 - 1)
    steps: int | None = Field(None, ge=1, le=1000)
    solver: Literal["ddim", "dpmpp_2m", "unipc"] = "ddim"
    plain_steps: int | None = Field(
        None, ge=1, le=1000, description="Steps of the pass without shadow; as many by default."
    )
    guidance_interval: Interval = Field(
        (0.0, 1.0), description="Shares of the steps between which the guidance contrasts."
    )
    reuse: int = Field(
        1, ge=1, le=1000, description="All of the denoiser runs in one of so many steps."
    )
    fidelity: Literal["paper", "release"] = "paper"
    window: WindowMode = "auto"
    detail: Literal["auto", "renderer", "maps"] = "auto"

    def options(self) -> dict[str, Any]:
        """`RelightOptions` as asked for; what is left open is the plan's to choose."""
        always = ("gamma", "beta", "seed")
        given = [name for name in PLANNED if name in self.model_fields_set]
        return {
            name: value for name in (*always, *given) if (value := getattr(self, name)) is not None
        }
