"""The queue: who is next, who may end a job, and what becomes of it when a worker dies."""

from __future__ import annotations

import sqlite3
import threading
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spotlight_service.problems import FieldError
from spotlight_service.storage.database import Database
from spotlight_service.storage.fairness import Waiting, fair_order
from spotlight_service.storage.jobs import JobStore
from spotlight_service.storage.queue import WorkQueue
from spotlight_service.storage.records import QueueFullError


class Clock:
    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def database(tmp_path):
    opened = Database(tmp_path / "jobs.db")
    yield opened
    opened.close()


@pytest.fixture
def store(database, clock):
    return JobStore(database, limit=100, clock=clock)


@pytest.fixture
def queue(database, clock):
    return WorkQueue(database, lease=10.0, attempts=3, clock=clock)


def submit(store, job, owner="anna", key=None, digest="d", deadline=3600.0):
    request = {"scene": "s" * 64}
    return store.submit(job, owner, "mini", request, digest, deadline, key)


def test_a_job_goes_from_the_queue_to_its_end(store, queue, clock):
    submit(store, "a")
    assert store.get("a", "anna").state == "queued"
    claim = queue.claim("w", "mini")
    assert claim.job.state == "running"
    assert queue.claim("v", "mini") is None
    clock.now += 4.0
    assert queue.finish(claim, "done", report={"evaluations": 60})
    done = store.get("a", "anna")
    assert (done.state, done.attempt, done.report) == ("done", 1, {"evaluations": 60})
    assert store.seconds("mini") == 4.0


def test_a_job_is_its_owners_alone(store):
    submit(store, "a", "anna")
    assert store.get("a", "bert") is None
    assert store.cancel("a", "bert") is None
    assert store.get("a", "anna").state == "queued"
    assert store.latest("bert", 10) == []


def test_a_worker_takes_jobs_of_its_model_only(store, queue):
    submit(store, "a")
    assert queue.claim("w", "large") is None


def test_many_workers_never_get_the_same_job(tmp_path):
    path = tmp_path / "jobs.db"
    first = Database(path)
    store = JobStore(first, limit=100)
    for number in range(40):
        submit(store, f"{number}", owner=f"{number % 3}")
    claimed: list[str] = []

    def work(name: str) -> None:
        own = Database(path)  # as another process has
        queue = WorkQueue(own)
        while (claim := queue.claim(name, "mini")) is not None:
            claimed.append(claim.job.id)
            queue.finish(claim, "done")
        own.close()

    threads = [threading.Thread(target=work, args=(f"w{i}",)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first.close()
    assert sorted(claimed, key=int) == [f"{number}" for number in range(40)]


def test_a_dead_workers_job_is_done_by_another_and_ends_once(store, queue, clock):
    submit(store, "a")
    lost = queue.claim("dead", "mini")
    clock.now += 9.0
    assert queue.claim("w", "mini") is None  # it may yet live
    clock.now += 2.0
    again = queue.claim("w", "mini")
    assert (again.job.id, again.job.attempt) == ("a", 2)
    assert queue.verdict(lost) == "lost"
    assert not queue.finish(lost, "failed", error={})  # the dead one was only slow
    assert not queue.beat(lost)
    assert queue.finish(again, "done", report={})
    assert store.get("a", "anna").state == "done"


def test_signs_of_life_keep_a_job(store, queue, clock):
    submit(store, "a")
    claim = queue.claim("w", "mini")
    for _ in range(5):
        clock.now += 9.0
        assert queue.beat(claim)
    assert queue.claim("v", "mini") is None


def test_what_kills_every_worker_is_not_begun_for_ever(store, queue):
    submit(store, "a")
    for attempt in (1, 2, 3):
        assert queue.claim("w", "mini").job.attempt == attempt
        assert queue.abandon("w") == 1
    assert queue.claim("w", "mini") is None
    failed = store.get("a", "anna")
    assert failed.state == "failed"
    assert "3 times" in failed.error["detail"]


def test_a_job_given_back_is_as_good_as_new(store, queue):
    submit(store, "a")
    for _ in range(5):
        queue.release(queue.claim("w", "mini"))
    assert (store.get("a", "anna").state, store.get("a", "anna").attempt) == ("queued", 0)


def test_all_running_jobs_are_taken_back_at_a_start(store, queue):
    for job in ("a", "b", "c"):
        submit(store, job)
    queue.claim("w", "mini")
    queue.claim("v", "mini")
    assert queue.abandon() == 2
    assert {queue.claim("n", "mini").job.id for _ in range(3)} == {"a", "b", "c"}


def test_cancelling(store, queue):
    submit(store, "waiting")
    submit(store, "running")
    claim = queue.claim("w", "mini")
    assert store.cancel("running", "anna").state == "cancelled"  # it was the one that waited
    assert queue.verdict(claim) == "go on"
    assert store.cancel("waiting", "anna").cancelling
    assert queue.verdict(claim) == "cancel"
    queue.finish(claim, "cancelled")
    again = store.cancel("waiting", "anna")
    assert (again.state, again.finished) == ("cancelled", store.get("waiting", "anna").finished)


def test_a_cancelled_job_whose_worker_dies_is_not_begun_again(store, queue):
    submit(store, "a")
    queue.claim("w", "mini")
    store.cancel("a", "anna")
    queue.abandon("w")
    assert store.get("a", "anna").state == "cancelled"


def test_deadlines(store, queue, clock):
    submit(store, "late", deadline=5.0)
    submit(store, "later", deadline=50.0)
    clock.now += 6.0
    claim = queue.claim("w", "mini")
    assert claim.job.id == "later"
    assert store.get("late", "anna").error["status"] == 504
    clock.now += 50.0
    queue.beat(claim)
    assert queue.verdict(claim) == "deadline"


def test_the_queue_is_bounded_and_says_how_long_it_is(database, clock):
    store = JobStore(database, limit=2, clock=clock)
    submit(store, "a")
    submit(store, "b")
    with pytest.raises(QueueFullError) as caught:
        submit(store, "c")
    assert caught.value.status == 429
    assert int(caught.value.headers["Retry-After"]) >= 1
    assert caught.value.more["wait_s"] == 30.0  # three times the first guess
    assert store.get("c", "anna") is None


def test_idempotency_keys_are_each_owners_own(store):
    assert submit(store, "a", "anna", "k").created
    assert submit(store, "b", "bert", "k").created
    again = submit(store, "c", "anna", "k")
    assert (again.created, again.job.id) == (False, "a")
    with pytest.raises(FieldError, match="Idempotency-Key"):
        submit(store, "d", "anna", "k", digest="another")


def test_old_jobs_are_forgotten_and_running_ones_never(store, queue, clock):
    submit(store, "old")
    queue.finish(queue.claim("w", "mini"), "done", report={})
    submit(store, "new")
    clock.now += 100.0
    assert store.expire(60.0) == ["old"]
    assert store.ids() == {"new"}


def test_changes_are_told_in_order_and_once(store, queue):
    submit(store, "a")
    submit(store, "b")
    since = store.revision()
    claim = queue.claim("w", "mini")
    queue.tell(claim, progress={"step": 1})
    told = store.changes(since)
    assert [job.id for job in told] == ["a"]
    assert told[0].progress == {"step": 1}
    assert store.changes(told[-1].revision) == []


def test_an_interrupted_transaction_leaves_nothing(database):
    def half() -> None:
        with database.writing() as connection:
            connection.execute("UPDATE counters SET value = 77")
            connection.execute("no SQL at all")

    with pytest.raises(sqlite3.OperationalError):
        half()
    assert {row["value"] for row in database.rows("SELECT value FROM counters")} == {0}


def test_an_unknown_state_cannot_be_stored(database):
    with pytest.raises(sqlite3.IntegrityError), database.writing() as connection:
        connection.execute(
            "INSERT INTO jobs (id, owner, model, state, request, digest, ticket, created, deadline,"
            " revision) VALUES ('a', 'o', 'm', 'lost', '{}', 'd', 1, 1, 1, 1)"
        )


def test_nobody_waits_behind_anothers_hundred_jobs(store, queue):
    for number in range(20):
        submit(store, f"anna-{number}", "anna")
    submit(store, "bert-0", "bert")
    job = store.get("bert-0", "bert")
    assert store.position(job) == 1
    order = []
    while (claim := queue.claim("w", "mini")) is not None:
        order.append(claim.job.id)
        queue.finish(claim, "done", report={})
    assert order[:3] == ["anna-0", "bert-0", "anna-1"]


lines = st.lists(st.sampled_from("abc"), max_size=12)


@given(
    owners=lines,
    turns=st.dictionaries(st.sampled_from("abc"), st.integers(0, 9)),
    running=st.dictionaries(st.sampled_from("abc"), st.integers(0, 3)),
)
def test_fair_order_is_fair(owners, turns, running):
    waiting = [Waiting(f"{i}", owner, i) for i, owner in enumerate(owners)]
    order = fair_order(waiting, turns, running)
    assert sorted(order) == sorted(job.id for job in waiting)
    by_id = {job.id: job for job in waiting}
    begun = Counter(running)
    for place, job in enumerate(order):
        later = {by_id[other].owner for other in order[place:]}
        assert all(begun[by_id[job].owner] <= begun[other] for other in later)
        begun[by_id[job].owner] += 1
    for owner in "abc":
        own = [int(job) for job in order if by_id[job].owner == owner]
        assert own == sorted(own)
