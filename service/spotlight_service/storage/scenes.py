"""Scenes on disk, by content: the same scene is stored once, whoever sends it how often."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from spotlight_service.storage.database import Database
from spotlight_service.storage.scene_info import SceneInfo
from spotlight_spec import encode, read_json, write_json
from spotlight_spec.records import decode

__all__ = ["SceneStore"]

INFO_FILE: Final = "service.json"
_FRESH_S: Final = 3600.0
"""Seconds after which an unfinished folder is nobody's any more."""


class SceneStore:
    """Folders below ``scenes/``, named by what is in them, and who may use which.

    A folder is written under another name and renamed when it is whole; one that has its own name
    is never written to again.

    Parameters
    ----------
    root : Path
        Made where it does not exist.
    database : Database
        Holds who sent which scene, and when it was last used.
    clock : callable
    """

    def __init__(
        self, root: Path, database: Database, clock: Callable[[], float] = time.time
    ) -> None:
        self.root, self._db, self._clock = root, database, clock
        root.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def draft(self) -> Iterator[Path]:
        """A folder to make a scene in; removed afterwards unless `adopt` took it."""
        folder = Path(tempfile.mkdtemp(dir=self.root, prefix=".draft-"))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def adopt(self, made: Path, info: SceneInfo, owner: str) -> None:
        """Take a finished scene in for its owner.

        Parameters
        ----------
        made : Path
            The scene's folder, inside a draft.
        info : SceneInfo
        owner : str
        """
        write_json(made / INFO_FILE, encode(info))
        target = self.root / info.id
        if not target.exists():
            try:
                made.rename(target)
            except OSError:  # somebody else was faster with the very same
                if not target.exists():
                    raise
        self._touch(info.id, owner)

    def find(self, scene: str, owner: str) -> SceneInfo | None:
        """What is known of an owner's scene; None where there is none."""
        row = self._db.row("SELECT used FROM scenes WHERE id = ? AND owner = ?", scene, owner)
        path = self.folder(scene) / INFO_FILE
        if row is None or not path.is_file():
            return None
        return decode(SceneInfo, read_json(path), "scene")

    def use(self, scene: str, owner: str) -> None:
        """Remember that a scene was used just now, so that it is among the last to go."""
        self._touch(scene, owner)

    def folder(self, scene: str) -> Path:
        """Where a scene lies."""
        return self.root / scene

    def evict(self, most: int, keep: set[str]) -> list[str]:
        """Remove the least recently used scenes until the rest is small enough.

        Parameters
        ----------
        most : int
            Bytes.
        keep : set of str
            Ids of scenes that jobs still need.

        Returns
        -------
        list of str
            Ids of what is gone.
        """
        used = {
            row["id"]: row["last"]
            for row in self._db.rows("SELECT id, max(used) AS last FROM scenes GROUP BY id")
        }
        sizes = {}
        for folder in self.root.iterdir():
            if folder.name.startswith("."):
                if self._clock() - folder.stat().st_mtime > _FRESH_S:
                    shutil.rmtree(folder, ignore_errors=True)
            else:
                sizes[folder.name] = sum(file.stat().st_size for file in folder.iterdir())
        held, gone = sum(sizes.values()), []
        for scene in sorted(sizes, key=lambda each: used.get(each, 0.0)):
            if held <= most:
                break
            if scene in keep:
                continue
            with self._db.writing() as connection:
                connection.execute("DELETE FROM scenes WHERE id = ?", (scene,))
            doomed = self.root / f".gone-{scene}-{os.getpid()}"
            (self.root / scene).rename(doomed)
            shutil.rmtree(doomed, ignore_errors=True)
            held -= sizes[scene]
            gone.append(scene)
        return gone

    def _touch(self, scene: str, owner: str) -> None:
        with self._db.writing() as connection:
            connection.execute(
                "INSERT INTO scenes VALUES (?, ?, ?)"
                " ON CONFLICT DO UPDATE SET used = excluded.used",
                (scene, owner, self._clock()),
            )
