"""Relighting on Ray Serve: replicas share the one queue, on this machine or wherever its disk is.

The API is the same process with the same store; only who works the queue off is another. For every
job that waits, one call that says "work" goes through Serve's router, so that Serve's own numbers
scale the replicas; the replica that gets it claims from the store whose turn it is. A replica that
dies takes its lease along, and the job goes to another.
"""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import uuid
from typing import Any, Final

import ray
from ray import serve
from ray.exceptions import RayError
from ray.serve.config import AutoscalingConfig
from ray.serve.handle import DeploymentHandle

from spotlight_service.engine.worker import Bench, set_up
from spotlight_service.logs import configure_logging
from spotlight_service.settings import Settings
from spotlight_service.storage.database import Database
from spotlight_service.storage.jobs import JobStore

__all__ = ["RayCrew", "Replica"]

LOOK_S: Final = 0.1
"""Between two looks at the queue."""
CALM_S: Final = 10.0
"""Seconds of few jobs after which replicas are let go, and of many after which some are added."""
NOTE_S: Final = 5.0
TEMPORARY: Final = os.environ.get("RAY_TMPDIR") or "/tmp/ray"
"""Sockets are in it, whose paths must be shorter than a data folder's may be."""
PARTING_S: Final = 2.0
"""Seconds a replica has to finish at shutdown; what it does not finish is done again."""
log = logging.getLogger(__name__)


class Replica:
    """A model, loaded once, that does what the queue holds.

    Parameters
    ----------
    settings : dict
        `Settings` as JSON.
    model : str
    """

    def __init__(self, settings: dict[str, Any], model: str) -> None:
        configure_logging()
        chosen = Settings.model_validate(settings)
        self._stopping = threading.Event()
        self._bench: Bench = set_up(chosen, model, f"ray-{uuid.uuid4().hex[:12]}")
        self._bench.note()
        threading.Thread(target=self._note, name="notes", daemon=True).start()

    def work(self) -> bool:
        """Do one job; False if another replica was faster."""
        return self._bench.work_once(self._stopping)

    def _note(self) -> None:
        while not self._stopping.wait(NOTE_S):
            self._bench.note()


class RayCrew:
    """Who works the queue off, in place of `Workforce`.

    Parameters
    ----------
    settings : Settings
    most : int
        Replicas of each model to scale out to.
    least : int
        Replicas that are always there.
    address : str, optional
        Of a Ray cluster; by default one is begun on this machine.
    """

    def __init__(
        self, settings: Settings, most: int = 2, least: int = 1, address: str | None = None
    ) -> None:
        self._settings, self._most, self._least = settings, most, least
        self._address = address
        self._database = Database(settings.data / "service.db")
        self._store = JobStore(self._database, limit=settings.queue)
        self._calls: dict[str, set[asyncio.Task[None]]] = {m: set() for m in settings.models}

    async def run(self) -> None:
        """Deploy, and pass every waiting job on as a call, until cancelled."""
        handles = await asyncio.to_thread(self._deploy)
        while True:
            waiting = self._store.counts()
            for model, handle in handles.items():
                calls = self._calls[model]
                wanted = min(waiting[model, "queued"] + waiting[model, "running"], 2 * self._most)
                for _ in range(wanted - len(calls)):
                    call = asyncio.create_task(self._call(handle))
                    calls.add(call)
                    call.add_done_callback(calls.discard)
            await asyncio.sleep(LOOK_S)

    def stop(self, patience: float) -> None:
        """Take the replicas down; what they were at goes back to the queue."""
        serve.shutdown()
        ray.shutdown()
        self._database.close()

    def _deploy(self) -> dict[str, DeploymentHandle]:
        if not ray.is_initialized():
            ray.init(
                address=self._address,
                include_dashboard=False,
                configure_logging=False,
                runtime_env={"env_vars": {"PYTHONWARNINGS": "ignore"}},  # Ray's own, hundreds
                _temp_dir=None if self._address else TEMPORARY,
            )
        serve.start(proxy_location="Disabled")  # calls come through handles, none by HTTP
        settings = self._settings.model_dump(mode="json")
        scaling = AutoscalingConfig(
            min_replicas=self._least,
            max_replicas=self._most,
            initial_replicas=self._least,
            target_ongoing_requests=1.0,
            upscale_delay_s=CALM_S / 5,
            downscale_delay_s=6 * CALM_S,
        )
        handles = {}
        for number, model in enumerate(self._settings.models):
            deployment = serve.deployment(
                Replica,
                name="relight",
                max_ongoing_requests=1,
                autoscaling_config=scaling,
                ray_actor_options={"num_cpus": 0},  # threads are a setting of the service
                graceful_shutdown_timeout_s=PARTING_S,
            )
            application = deployment.bind(settings, model)
            handles[model] = serve.run(application, name=f"spotlight-{number}", route_prefix=None)
        log.info("deployed", extra={"replicas": self._most, "models": list(handles)})
        return handles

    async def _call(self, handle: DeploymentHandle) -> None:
        try:
            await handle.work.remote()
        except RayError as error:
            # The replica died; its job goes back to the queue when its lease is over.
            log.warning("replica lost", extra={"cause": type(error).__name__})
            await asyncio.sleep(1.0)
