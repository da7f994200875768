"""The engine of a Monte Carlo: the same bytes, whoever measures a sample and however it is interrupted."""

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from engine_jobs import NAMES, job

import cosim
from cosim.errors import InputError
from cosim.tolerance.engine import Job, _alone, merge, run, shard
from cosim.tolerance.sample_store import Samples
from cosim.tolerance.worker_pool import Chunk, pooled, prepare_pool

HERE = Path(__file__).parent
N = 203


def undisturbed(folder, n=N, **more):
    samples = run(job(folder, n, **more), folder / "mc", workers=1, chunk=n)
    return (samples.folder / "samples.parquet").read_bytes(), samples


def times_measured(folder):
    """Return how often each sample was measured."""
    counts = np.zeros(N, int)
    for line in (folder / "log").read_text().splitlines():
        first, count = map(int, line.split())
        counts[first : first + count] += 1
    return counts


@pytest.mark.parametrize(
    ("workers", "chunk"),
    [(2, 7), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((1, 1), (8, None), (8, 1)))],
)
def test_workers_and_chunks_leave_the_same_bytes(tmp_path, workers, chunk):
    truth, samples = undisturbed(tmp_path / "truth", failing=(3, 100))
    other = run(job(tmp_path / "other", N, failing=(3, 100)), tmp_path / "other" / "mc",
                workers=workers, chunk=chunk)  # fmt: skip
    assert (other.folder / "samples.parquet").read_bytes() == truth
    assert (times_measured(tmp_path / "other") == 1).all()
    assert not (other.folder / "parts").exists()
    measures, failures = samples.read()
    assert failures == dict.fromkeys((3, 100), dict.fromkeys(NAMES, "no circuit"))
    assert np.isnan(measures[[3, 100]]).all()
    assert np.isfinite(np.delete(measures, [3, 100], axis=0)).all()


@pytest.mark.slow
def test_a_sample_that_takes_its_process_with_it_fails_alone(tmp_path):
    samples = run(job(tmp_path, 40, deadly=(17,)), tmp_path / "mc", workers=2, chunk=8)
    measures, failures = samples.read()
    assert list(failures) == [17]
    assert all("SIGKILL" in failures[17][name] for name in NAMES)
    assert np.flatnonzero(np.isnan(measures).any(axis=1)).tolist() == [17]


def test_shards_that_are_merged_leave_the_same_bytes(tmp_path):
    truth, _ = undisturbed(tmp_path / "truth")
    folders = []
    for i in range(1, 4):
        folders.append(tmp_path / f"shard{i}")
        run(job(tmp_path / "shards", N), folders[-1], workers=1, part=(i, 3))
    result = job(tmp_path / "merged", N)
    with pytest.raises(InputError, match="samples are missing: 67 to 134"):
        merge(result, tmp_path / "merged" / "mc", [folders[0], folders[2]])
    merged = merge(result, tmp_path / "merged" / "mc", folders[::-1])
    assert (merged.folder / "samples.parquet").read_bytes() == truth
    assert [shard(10, (i, 3)) for i in (1, 2, 3)] == [(0, 3), (3, 6), (6, 10)]


def test_what_is_not_ours_is_left_alone(tmp_path):
    mine = job(tmp_path, 10)
    run(mine, tmp_path / "mc", workers=1)
    before = (tmp_path / "mc" / "samples.parquet").read_bytes()
    with pytest.raises(InputError, match="holds another study"):
        run(Job("other", mine.names, 10, mine.make), tmp_path / "mc", workers=1)
    with pytest.raises(InputError, match="no samples of this study"):
        merge(mine, tmp_path / "mc", [tmp_path / "nowhere"])
    with pytest.raises(InputError, match="is not a shard"):
        run(mine, tmp_path / "mc", part=(4, 3))
    assert (tmp_path / "mc" / "samples.parquet").read_bytes() == before


def test_a_folder_of_a_study_that_kept_nothing_is_free(tmp_path):
    """A cluster that is not there, or Ctrl-C before the first sample, left one that refused other studies."""
    folder, mine, other = tmp_path / "mc", job(tmp_path, 10), job(tmp_path, 12)
    with pytest.raises(InputError, match="samples are missing"):
        merge(mine, folder, [])
    named = (folder / "study.json").read_bytes()
    # not while its process works, nor what is no study's, nor where anything is kept
    with (folder / "study.json").open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="holds another study"):
            run(other, folder, workers=1)
    for name in ("parts", "levels", "samples.parquet"):
        (folder / name).mkdir()
        with pytest.raises(InputError, match="holds another study"):
            run(other, folder, workers=1)
        (folder / name).rmdir()
    (folder / "study.json").write_text('{"title": "years of work"}')
    with pytest.raises(InputError, match="holds another study"):
        run(other, folder, workers=1)
    assert [path.name for path in folder.iterdir()] == ["study.json"]
    (folder / "study.json").write_bytes(named)
    assert len(run(other, folder, workers=1).read()[0]) == 12
    with pytest.raises(InputError, match="holds another study"):
        run(mine, folder, workers=1)


def test_a_folder_that_another_process_has_just_taken_is_left_to_it(tmp_path):
    """Both found it free, the other named its study last: it was written over before ours began."""
    folder = tmp_path / "mc"
    samples = Samples(folder, "one", NAMES, 0, 10)
    Samples(folder, "two", NAMES, 0, 10)
    with pytest.raises(InputError, match="holds another study"), _alone(samples):
        pytest.fail("both work in one folder")


def test_a_flipped_bit_of_the_samples_is_found(tmp_path):
    """All of 17,776 were tried once; without checksums a third gave other numbers in silence."""
    folder, table = tmp_path / "study", np.random.default_rng(1).normal(size=(40, 2))
    study = Samples(folder, "d", ("a", "b"), 0, 40)
    study.keep(0, table, {3: {"a": "why"}})
    file = study.finish()
    sound = file.read_bytes()
    outcomes = set()
    for bit in range(0, 8 * len(sound), 17):
        flipped = bytearray(sound)
        flipped[bit // 8] ^= 1 << bit % 8
        file.write_bytes(flipped)
        try:
            measures, missing = Samples(folder, "d", ("a", "b"), 0, 40, made=True).read()
        except InputError as error:
            outcomes.add("refused" if "is damaged" in str(error) else str(error))
        else:  # of the file's own notes
            assert np.array_equal(measures, table)
            assert missing == {3: {"a": "why"}}
            outcomes.add("no matter")
    assert outcomes == {"refused", "no matter"}


def test_a_damaged_part_is_measured_again(tmp_path):
    truth, _ = undisturbed(tmp_path / "truth")
    parts = tmp_path / "mc" / "parts"
    parts.mkdir(parents=True)
    (parts / "000000000010-5.parquet").write_bytes(b"PAR1 cut off")
    other = run(job(tmp_path, N), tmp_path / "mc", workers=1, chunk=50)
    assert (other.folder / "samples.parquet").read_bytes() == truth


def interrupted(folder, kill_after_s, whom):
    """Start a slow study in a process of its own and kill it, or one of its workers."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, str(HERE / "engine_jobs.py"), str(folder), str(N), "0.03", "2"]
    process = subprocess.Popen(
        command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    if whom in ("worker", "template"):
        victims = []
        while not victims and process.poll() is None:
            time.sleep(0.05)
            templates = [pid for pid in children(process.pid) if is_template(pid)]
            victims = [worker for pid in templates for worker in children(pid)]
        time.sleep(0.2 * kill_after_s)
        for pid in (templates if whom == "template" else victims)[-1:] if process.poll() is None else []:
            os.kill(pid, signal.SIGKILL)
        assert process.wait(60) == 0
    else:
        time.sleep(kill_after_s)
        process.send_signal(whom)
        process.wait(60)
        with suppress(ProcessLookupError):  # workers that outlive their parent end with their chunk
            for _ in range(600):
                os.killpg(process.pid, 0)
                time.sleep(0.1)


def children(pid):
    return list(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))


def is_template(pid):
    """Whether this is the process that copies itself for each worker."""
    return b"forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes()


AT_THE_START = """
import sys
from pathlib import Path
from multiprocessing.context import ForkServerProcess
from engine_jobs import NAMES, job
from cosim.tolerance.engine import run
start = ForkServerProcess.start
def interrupted(self):
    start(self)
    {what}
ForkServerProcess.start = interrupted
run(job(sys.argv[1], 20), Path(sys.argv[1]) / "mc", workers=2, chunk=5)
"""


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ("raise KeyboardInterrupt", -signal.SIGINT),
        ("self.kill(); self.join(); ForkServerProcess.start = start", 0),
    ],
)
def test_a_study_ends_whatever_happens_while_a_process_starts(tmp_path, what, code):
    """Ctrl-C before the pool knows of its process left the command waiting for that one at its end."""
    (tmp_path / "start.py").write_text(
        "if __name__ == '__main__':\n" + textwrap.indent(AT_THE_START.format(what=what), "    ")
    )
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, str(tmp_path / "start.py"), str(tmp_path)]
    ended = subprocess.run(command, env=env, timeout=60, capture_output=True, text=True)
    assert ended.returncode == code, ended.stderr
    assert code or (tmp_path / "mc" / "samples.parquet").exists()


@pytest.mark.few(1)
@pytest.mark.parametrize("whom", [signal.SIGKILL, signal.SIGINT, "worker", "template"])
def test_an_interrupted_study_goes_on_and_ends_with_the_same_bytes(tmp_path, whom):
    truth, _ = undisturbed(tmp_path / "truth")
    folder = tmp_path / "killed"
    for wait_s in (2.0, 4.0):
        interrupted(folder, wait_s, whom)
    kept = {path.name for path in (folder / "mc" / "parts").glob("*.parquet")}
    other = run(job(folder, N), folder / "mc", workers=2, chunk=9)
    assert (other.folder / "samples.parquet").read_bytes() == truth
    counts = times_measured(folder)
    # what a part held was not measured again
    for name in kept:
        first, count = map(int, name.removesuffix(".parquet").split("-"))
        assert (counts[first : first + count] == 1).all()


def test_workers_have_the_environment_and_the_modules_of_their_parent(tmp_path, monkeypatch):
    """Their template may have started long before: in another environment, or where other modules lie."""
    prepare_pool()
    monkeypatch.setenv("COSIM_TEST_OF_A_POOL", "later")
    monkeypatch.chdir(tmp_path)
    got = [answer for _, answer in pooled(Surroundings(), [Chunk(k, 1) for k in range(4)], 2)]
    assert got == [("later", str(tmp_path), cosim.__file__)] * 4


class Surroundings:
    """Tells of the process that it works in."""

    def __call__(self):
        return lambda chunk: (os.environ.get("COSIM_TEST_OF_A_POOL"), os.getcwd(), cosim.__file__)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_what_is_copied_for_each_worker_has_one_thread(tmp_path):
    """A copy of a process with threads may find a lock that nobody opens any more.

    And what it loads is never a file of the folder that it happens to be in.
    """
    (tmp_path / "scipy.py").write_text("raise SystemExit('a stranger')")
    code = "from cosim.tolerance.worker_pool import prepare_pool; prepare_pool(); input()"
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, env=env, cwd=tmp_path) as of:
        end = time.monotonic() + 60.0
        loaded = False
        while not loaded and time.monotonic() < end:
            time.sleep(0.2)
            templates = [pid for pid in children(of.pid) if is_template(pid)]
            loaded = any("pyarrow" in Path(f"/proc/{pid}/maps").read_text() for pid in templates)
        time.sleep(1.0)
        threads = [len(os.listdir(f"/proc/{pid}/task")) for pid in templates]
        of.kill()
    assert loaded
    assert threads == [1]


SPAWNED = """
import sys
from pathlib import Path
from multiprocessing.context import SpawnProcess
from engine_jobs import job
from cosim.tolerance import engine, worker_pool
{before}
if __name__ == "__main__":
    started, start = [], SpawnProcess.start
    SpawnProcess.start = lambda self: (started.append(self), start(self))
    copies = worker_pool.prepare_pool()
    engine.run(job(sys.argv[1], 40, deadly=(17,)), Path(sys.argv[1]) / "mc", workers=2, chunk=8)
    print(int(copies), len(started))
"""


@pytest.mark.few(1)
@pytest.mark.parametrize("why", ["another system", "a long path"])
def test_where_no_process_can_be_copied_workers_are_started_anew(tmp_path, why):
    """A socket's path has 108 bytes at most: `bind` refuses a longer one, or Python takes another folder."""
    before = "sys.platform = 'darwin'" if why == "another system" else ""
    place = tmp_path / ("x" * 60) / ("y" * 60)
    place.mkdir(parents=True)
    (tmp_path / "spawned.py").write_text(SPAWNED.format(before=before))
    path = os.pathsep.join(p for p in sys.path if p)
    env = {**os.environ, "PYTHONPATH": path, "TMPDIR": str(place if why == "a long path" else tmp_path)}
    command = [sys.executable, str(tmp_path / "spawned.py"), str(tmp_path / "here")]
    ended = subprocess.run(command, env=env, timeout=120, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    copies, started = map(int, ended.stdout.split())
    # both workers, and another for each that the sample took with it
    assert started == 0 if copies else started >= 4
    assert not copies or (why == "a long path" and sys.version_info >= (3, 14))  # that takes /tmp instead
    _, failures = run(job(tmp_path / "here", 40), tmp_path / "here" / "mc", workers=1).read()
    assert {k: sorted(each) for k, each in failures.items()} == {17: sorted(NAMES)}
    # what is left of the samples are those of a study by copies of a template
    truth = run(job(tmp_path / "truth", 40, deadly=(17,)), tmp_path / "truth" / "mc", workers=2, chunk=8)
    assert (tmp_path / "here" / "mc" / "samples.parquet").read_bytes() == (
        truth.folder / "samples.parquet"
    ).read_bytes()
    assert not list(place.iterdir()), "a socket's folder stays"


@pytest.fixture
def short_folder():
    """Return a folder whose path leaves a socket room."""
    with tempfile.TemporaryDirectory(prefix="c", dir="/tmp") as name:
        yield Path(name)


@pytest.mark.skipif(sys.platform != "linux", reason="no template elsewhere")
def test_what_a_killed_template_left_is_swept_by_the_next_process(short_folder):
    """A kill -9 of a study and of its template leaves the socket's folder; nobody who lives loses his."""
    code = "from cosim.tolerance.worker_pool import prepare_pool; print(prepare_pool(), flush=True); input()"
    path = os.pathsep.join(p for p in sys.path if p)
    env = {**os.environ, "PYTHONPATH": path, "TMPDIR": str(short_folder)}

    def folders():
        return {path.name for path in short_folder.glob("cosim-pool.*")}

    with ExitStack() as stack:

        def started():
            of = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                  env=env, text=True)  # fmt: skip
            stack.enter_context(of)
            stack.callback(of.kill)
            assert of.stdout.readline() == "True\n"
            return of

        first, second = started(), started()
        before = folders()
        assert len(before) == 2
        (template,) = [pid for pid in children(first.pid) if is_template(pid)]
        os.kill(template, signal.SIGKILL)
        first.kill()
        first.wait()
        assert folders() == before  # nobody was left to remove it
        third = started()
        (kept,) = folders() & before
        assert f"-{second.pid}." in kept
        for each in (second, third):  # they end by themselves, and take their own with them
            each.communicate("\n", timeout=60)
    assert folders() == set()
