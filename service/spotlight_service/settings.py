"""What can be set: by arguments, by ``SPOTLIGHT_SERVE_*`` in the environment, or as it is here."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from spotlight_runtime.networks.models import Engine

__all__ = ["LOOPBACK", "Settings"]

LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")
MIB: Final = 1 << 20


def _data_folder() -> Path:
    root = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(root) / "spotlight-relight"


class Settings(BaseSettings):
    """Settings of a service.

    Attributes
    ----------
    data : Path
        Folder of the database, scenes and results; one service a folder.
    host, port
        Where to listen.
    insecure_open : bool
        Listen beyond loopback without API keys.
    models : tuple of str
        Names or folders; one worker each. In the environment with commas between them.
    engine : {"onnxruntime", "openvino", "openvino-bf16"}
        What computes the networks.
    threads : int, optional
        Threads of one inference; by default the CPUs the process may use.
    measure : bool
        Measure at the start what plans take on this machine, so that they can be told; budgets
        are measured for in any case.
    queue : int
        Jobs that may wait; further ones are answered 429.
    deadline_s, longest_deadline_s : float
        Seconds from submission until a job is given up, where a request says nothing and at most.
    longest_wait_s : float
        Most seconds of ``Prefer: wait``.
    result_ttl_s : float
        Seconds a finished job and its result are kept.
    lease_s : float
        Seconds without a sign of life after which a worker's job goes back to the queue.
    attempts : int
        Times a job is begun before it counts as what kills workers.
    max_upload_bytes, max_json_bytes : int
        Of a request's body; the first where files are uploaded.
    max_unpacked_bytes, max_files
        Of a zipped scene.
    max_pixels : int
        Of any picture, by its header, before it is decoded.
    upload_s, studio_s : float
        Seconds a body may take to arrive, and one piece of the studio's work.
    studio_bytes : int
        Address space of the studio; 0: unlimited.
    scene_cache_bytes : int
        Of loaded scenes, in each worker and in the studio.
    scene_store_bytes : int
        Of scenes on disk; the least recently used go first.
    min_free_bytes : int
        Space that is left free on the disk; requests that store are answered 507 below it.
    requests_per_minute : int
        Of one caller, where its key says nothing else.
    keep_alive_s : float
        Seconds between comments on a silent event stream.
    stop_s : float
        Seconds a worker may take to reach the end of its step at shutdown.
    """

    model_config = SettingsConfigDict(env_prefix="SPOTLIGHT_SERVE_", extra="ignore")

    data: Path = Field(default_factory=_data_folder)
    host: str = "127.0.0.1"
    port: int = Field(default=8471, ge=0, le=65535)
    insecure_open: bool = False
    models: Annotated[tuple[str, ...], NoDecode, Field(min_length=1)] = ("mini",)
    engine: Engine = "onnxruntime"
    threads: int | None = Field(default=None, ge=1)
    measure: bool = True
    queue: int = Field(default=32, ge=1, le=1000)
    deadline_s: float = Field(default=1800.0, gt=0)
    longest_deadline_s: float = Field(default=24 * 3600.0, gt=0)
    longest_wait_s: float = Field(default=120.0, ge=0)
    result_ttl_s: float = Field(default=24 * 3600.0, gt=0)
    lease_s: float = Field(default=15.0, gt=0)
    attempts: int = Field(default=3, ge=1)
    max_upload_bytes: int = Field(default=256 * MIB, ge=1)
    max_json_bytes: int = Field(default=16 * MIB, ge=1)
    max_unpacked_bytes: int = Field(default=1024 * MIB, ge=1)
    max_files: int = Field(default=64, ge=1)
    max_pixels: int = Field(default=24_000_000, ge=1)
    upload_s: float = Field(default=120.0, gt=0)
    studio_s: float = Field(default=120.0, gt=0)
    studio_bytes: int = Field(default=8192 * MIB, ge=0)
    scene_cache_bytes: int = Field(default=1024 * MIB, ge=0)
    scene_store_bytes: int = Field(default=8192 * MIB, ge=0)
    min_free_bytes: int = Field(default=256 * MIB, ge=0)
    requests_per_minute: int = Field(default=1200, ge=1)
    keep_alive_s: float = Field(default=15.0, gt=0)
    stop_s: float = Field(default=20.0, gt=0)

    @field_validator("models", mode="before")
    @classmethod
    def _listed(cls, given: Any) -> Any:
        """Names of a text that is a list, whether or not it is written as JSON."""
        if not isinstance(given, str):
            return given
        names = (part.strip('[]" ') for part in given.split(","))
        return tuple(name for name in names if name)

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the service."""
        return self.host in LOOPBACK
