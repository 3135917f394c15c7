"""``spotlight-serve``: run the service, and its keys."""

from __future__ import annotations

import logging
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from pydantic import ValidationError

from spotlight_runtime.errors import SpotLightError
from spotlight_runtime.networks.models import Engine
from spotlight_service.problems import ProblemError, of_validation
from spotlight_service.security.keys import KeyStore
from spotlight_service.settings import Settings
from spotlight_service.storage.database import Database

if TYPE_CHECKING:
    from fastapi import FastAPI

__all__ = ["main"]

KEEP_ALIVE_S: Final = 30
"""Seconds an idle connection is kept for a next request."""
log = logging.getLogger(__name__)

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Serve relighting by REST, with a page to try it.",
    epilog="Start with:  spotlight-serve,  then open http://127.0.0.1:8471/",
)
keys = typer.Typer(no_args_is_help=True, help="API keys; needed beyond this machine.")
app.add_typer(keys, name="keys")

Data = Annotated[Path | None, typer.Option(help="Folder of database, scenes and results.")]


@app.callback(invoke_without_command=True)
def serve(
    context: typer.Context,
    data: Data = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen at.", show_default="127.0.0.1")
    ] = None,
    port: Annotated[int | None, typer.Option(show_default="8471")] = None,
    model: Annotated[
        list[str] | None, typer.Option(help="Model; repeat for several.", show_default="mini")
    ] = None,
    engine: Annotated[
        Engine | None,
        typer.Option(help="What computes the networks.", show_default="onnxruntime"),
    ] = None,
    threads: Annotated[int | None, typer.Option(help="Threads of one inference.")] = None,
    queue: Annotated[
        int | None, typer.Option(help="Jobs that may wait.", show_default="32")
    ] = None,
    insecure_open: Annotated[
        bool, typer.Option("--insecure-open", help="Listen beyond this machine without keys.")
    ] = False,
    ray: Annotated[
        bool, typer.Option("--ray", help="Relight on Ray Serve replicas (extra 'ray').")
    ] = False,
    replicas: Annotated[
        int, typer.Option(help="With --ray: most replicas to scale out to.", min=1)
    ] = 2,
) -> None:
    """Serve until told to stop. Further settings are SPOTLIGHT_SERVE_* in the environment."""
    if context.invoked_subcommand is not None:
        return
    given = {
        "data": data,
        "host": host,
        "port": port,
        "models": tuple(model) if model else None,
        "engine": engine,
        "threads": threads,
        "queue": queue,
        "insecure_open": insecure_open or None,
    }
    _serve({name: value for name, value in given.items() if value is not None}, ray, replicas)


@keys.command("add")
def add_key(
    name: Annotated[str, typer.Argument(help="Who it is for.")],
    scope: Annotated[
        list[str] | None, typer.Option(help="read, write, metrics.", show_default="read, write")
    ] = None,
    per_minute: Annotated[int | None, typer.Option(help="Requests a minute.", min=1)] = None,
    data: Data = None,
) -> None:
    """Make a key and print it; it is not shown again."""
    with _key_store(data) as store:
        print(store.create(name, scope or ("read", "write"), per_minute))


@keys.command("list")
def list_keys(data: Data = None) -> None:
    """Names and scopes of all keys."""
    with _key_store(data) as store:
        listed = store.listed()
    for key in listed:
        state = "revoked" if key["revoked"] else key["scopes"]
        print(f"{key['id']}  {key['name']}  {state}")


@keys.command("revoke")
def revoke_key(
    key: Annotated[str, typer.Argument(help="Its id, as `list` shows it.")], data: Data = None
) -> None:
    """Make a key void at once."""
    with _key_store(data) as store:
        found = store.revoke(key)
    if not found:
        print(f"spotlight-serve: {key}: expected the id of a key that is valid", file=sys.stderr)
        raise typer.Exit(1)


def _serve(given: dict[str, Any], ray: bool, replicas: int) -> None:
    from spotlight_runtime.networks.models import resolve_model
    from spotlight_service.app import create_app
    from spotlight_service.logs import configure_logging

    settings = Settings(**given)
    for model in settings.models:
        resolve_model(model)  # now, not in a worker that dies again and again
    configure_logging()
    crew: Any = "own"
    if ray:
        from spotlight_service.ray_serving import RayCrew

        crew = RayCrew(settings, replicas)
    service = create_app(settings, crew)
    needs_keys = service.state.service.access.needs_keys()
    if not (settings.loopback or needs_keys or settings.insecure_open):
        raise RuntimeError(
            f"host: expected a loopback address while there is no API key, got {settings.host}; "
            "make one (spotlight-serve keys add NAME), or say --insecure-open"
        )
    with _listening(settings.host, settings.port) as sockets:
        scratch = settings.data / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)  # of one that was killed
        scratch.mkdir(mode=0o700)
        # Uploads, too, on the disk whose space is watched; the studio is a child and does likewise.
        os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
        _run(service, settings, sockets)


def _run(service: FastAPI, settings: Settings, sockets: list[socket.socket]) -> None:
    import uvicorn

    config = uvicorn.Config(
        service,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=int(settings.stop_s),
        timeout_keep_alive=KEEP_ALIVE_S,
    )
    server = uvicorn.Server(config)
    leave = server.handle_exit

    def leaving(number: int, frame: FrameType | None) -> None:
        # Streams end and waiting requests are answered, or the server would wait for them.
        service.state.service.broker.close_soon()
        leave(number, frame)

    server.handle_exit = leaving  # type: ignore[method-assign, assignment]
    log.info("listening", extra={"at": [each.getsockname()[:2] for each in sockets]})
    server.run(sockets)


@contextmanager
def _listening(host: str, port: int) -> Iterator[list[socket.socket]]:
    """Sockets at all addresses of a host, before anything is begun that would be in vain."""
    with ExitStack() as opened:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            sockets = [
                opened.enter_context(socket.create_server(address, family=family))
                for family, _, _, _, address in found
            ]
        except OSError as error:
            why = str(error.strerror).partition(" (")[0]  # which goes on with the address again
            raise RuntimeError(
                f"host, port: expected an address that is free to listen at, got {host}:{port} "
                f"({why}); choose another (--host, --port)"
            ) from error
        yield sockets


@contextmanager
def _key_store(data: Path | None) -> Iterator[KeyStore]:
    settings = Settings() if data is None else Settings(data=data)
    database = Database(settings.data / "service.db")
    try:
        yield KeyStore(database)
    finally:
        database.close()


def main() -> None:
    """Entry point: what is wrong is one line on stderr and exit code 1."""
    try:
        app()
    except ImportError as error:
        print(
            f"spotlight-serve: {error.name or error} is missing: "
            "pip install 'spotlight-relight[service]' (and [ray] for --ray)",
            file=sys.stderr,
        )
        sys.exit(1)
    except ValidationError as error:
        of_settings = [{**each, "loc": ("settings", *each["loc"])} for each in error.errors()]
        print("spotlight-serve:", of_validation(of_settings), file=sys.stderr)
        sys.exit(1)
    except (SpotLightError, ProblemError, OSError, RuntimeError, ValueError) as error:
        print("spotlight-serve:", " ".join(str(error).split()), file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
