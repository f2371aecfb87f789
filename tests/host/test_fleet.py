"""Many robots: what is new is calibrated, nothing is lost; who wears sooner is named, a sound fleet is left alone."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet
import pytest
from cli_runner import Taut
from fleet_workers import doubled
from tools.fleet import robots

from tautline.errors import TautError
from tautline.fleet import sessions
from tautline.fleet.changes import compared
from tautline.fleet.findings import findings
from tautline.fleet.population import Curves, population
from tautline.fleet.rows import DATA_SET, DataSet, Row
from tautline.fleet.run import run
from tautline.pool import pool

PLACES = np.linspace(-5.0, 5.0, 33)
ROBOTS, SESSIONS = 4, 2


def still(fraction, text):
    """No progress."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small fleet, and what was run of it."""
    folder = tmp_path_factory.mktemp("fleet")
    robots.write(folder / "in", ROBOTS, SESSIONS, worn=1, seed=3, seconds=8.0)
    with pool(1, None) as here:
        done = run(folder / "in", folder / "out", here, still)
    return folder, done


@pytest.fixture
def fleet(made, tmp_path):
    """The same, to be changed."""
    shutil.copytree(made[0] / "in", tmp_path / "in")
    shutil.copytree(made[0] / "out", tmp_path / "out")
    return tmp_path


@pytest.fixture
def taut(monkeypatch, capsys):
    return Taut(monkeypatch, capsys)


def again(folder):
    with pool(1, None) as here:
        return run(folder / "in", folder / "out", here, still)


# ---- workers that die


@pytest.mark.parametrize("dies", ["", "once", "always"])
def test_a_worker_that_dies_loses_nothing(tmp_path, dies):
    marked = str(tmp_path / "died") if dies == "once" else dies
    work = ((str(number), (number, marked)) for number in range(8))
    with pool(2, None, lambda name: f"{name} died") as workers:
        done = dict(workers(doubled, work))
    expected = {str(number): 2 * number for number in range(8)}
    assert done == expected | ({"3": "3 died"} if dies == "always" else {})


def test_a_task_that_kills_its_workers_is_named_where_nothing_stands_for_it():
    with pytest.raises(TautError, match="3: every worker that had it died"), pool(2, None) as workers:
        list(workers(doubled, ((str(number), (number, "always")) for number in range(5))))


# ---- what is in a folder


def test_sessions_robots_batches_and_dates(tmp_path):
    for name in ("b/2026-02-01 noon", "b/2026-01-01", "a/first/one", "a/first/two", ".hidden/x", "c/nothing"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("b/2026-02-01 noon", "b/2026-01-01", "a/first/one", "a/first/two", ".hidden/x"):
        (tmp_path / name / "motor.csv").write_text("t_s,q_mm\n")
    (tmp_path / "rig.toml").write_text("of all")
    (tmp_path / "b" / "rig.toml").write_text("of b")
    (tmp_path / "robots.csv").write_text("robot,batch,colour\nb,B7,red\n")
    found = sessions.sessions_in(tmp_path)
    assert [(each.id, each.batch, each.date) for each in found] == [
        ("a/first", None, None),
        ("b/2026-01-01", "B7", "2026-01-01"),
        ("b/2026-02-01 noon", "B7", "2026-02-01"),
    ]
    assert found[0].files() == {"rig.toml": b"of all", "one/motor.csv": b"t_s,q_mm\n", "two/motor.csv": b"t_s,q_mm\n"}
    assert found[1].files()["rig.toml"] == b"of b"


@pytest.mark.parametrize("folder", ["absent", "."])
def test_a_folder_without_sessions_says_how_to_lay_them_out(tmp_path, folder):
    with pytest.raises(TautError, match="ROBOT/SESSION"):
        sessions.sessions_in(tmp_path / folder)


def test_the_hash_is_of_names_contents_and_version():
    files = {"a/motor.csv": b"1", "rig.toml": b"2"}
    same = sessions.digest(dict(reversed(files.items())), "v1")
    assert sessions.digest(files, "v1") == same
    others = [({**files, "rig.toml": b"3"}, "v1"), (files, "v2"), ({"b/motor.csv": b"1", "rig.toml": b"2"}, "v1")]
    assert same not in {sessions.digest(*each) for each in others}


# ---- runs


def test_every_session_is_a_row_of_the_data_set(made):
    folder, done = made
    assert done.new == len(done.rows) == ROBOTS * SESSIONS
    table = pyarrow.parquet.read_table(folder / "out" / DATA_SET).to_pylist()
    assert [(line["robot"], line["session"]) for line in table] == [(row.robot, row.session) for row in done.rows]
    assert all(line["verdict"] in ("good", "doubtful") and line["error"] is None for line in table)
    assert list(DataSet(folder / "out").read().values()) == list(done.rows)


def test_rows_hold_the_truth_within_their_sigma(made):
    _, done = made
    rig = robots.reference_rig()
    off = []
    for row in done.rows:
        number = int(row.robot[1:])
        worn = row.batch == "worn"
        truth = robots.Robot(3, number, worn).instrument(int(row.session), rig).backlash(np.array(row.q))
        inside = (np.array(row.q) > row.measured_low) & (np.array(row.q) < row.measured_high)
        off.append(((np.array(row.width) - truth) / np.array(row.width_sigma))[inside])
    z = np.concatenate(off)
    assert np.sqrt(np.mean(z**2)) < 1.5  # 1 where the sigmas are right; a few tens of independent values


def test_a_second_run_does_only_what_is_new(fleet):
    assert again(fleet).new == 0
    motor = fleet / "in" / "r0001" / "01" / "motor.csv"
    motor.write_text("\n".join(motor.read_text().splitlines()[:-2]) + "\n")
    shutil.copytree(fleet / "in" / "r0000" / "01", fleet / "in" / "r0000" / "02")
    shutil.rmtree(fleet / "in" / "r0003")
    done = again(fleet)
    assert done.new == 2
    assert [row.id for row in done.rows] == [
        f"r000{k}/0{s}" for k, s in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1)]
    ]


def test_a_run_that_is_stopped_keeps_what_was_done(fleet):
    shutil.rmtree(fleet / "out")

    def stopped(function, work):
        for count, (name, arguments) in enumerate(work):
            if count == 2:
                raise KeyboardInterrupt
            yield name, function(*arguments)

    with pytest.raises(KeyboardInterrupt):
        run(fleet / "in", fleet / "out", stopped, still)
    assert len(DataSet(fleet / "out").read()) == 2
    assert again(fleet).new == ROBOTS * SESSIONS - 2


def test_a_bad_session_is_a_row_and_no_end(fleet, taut):
    (fleet / "in" / "r0002" / "00" / "motor.csv").write_text("t_s,elsewhere\n0,1\n")
    done = taut("fleet", fleet / "in", "--out", fleet / "out", "--jobs", 1, "--json")
    assert done.code == 0
    said = json.loads(done.out)
    assert (said["new"], list(said["errors"]), said["sessions"]) == (1, ["r0002/00"], ROBOTS * SESSIONS)
    assert "r0002/00: 00/motor.csv: " in done.err
    assert "r0002" in (fleet / "out" / "fleet.html").read_text()


# ---- what the rows say


def row(robot, session, width, sigma=0.002, batch=None):
    curve = tuple(np.broadcast_to(width, PLACES.shape).tolist())
    straight = tuple((12.0 * PLACES).tolist())
    return Row(
        robot, f"{session:02d}", "x", batch, verdict="good", unit="mm", q=tuple(PLACES.tolist()), width=curve,
        width_sigma=(sigma,) * 33, c_deg=straight, c_sigma_deg=(0.1,) * 33, measured_low=-4.0, measured_high=4.0,
    )  # fmt: skip


def fleet_of(rng, count, growth, sessions=6, batches=None, scatter=0.002):
    """Rows whose B (spread by 30 %, in size and in shape) grows by growth[k] a session."""
    rows = []
    for k in range(count):
        shape = 0.5 * np.exp(rng.normal(0.0, 0.3) + 0.1 * np.sin(0.5 * PLACES + rng.uniform(0.0, 6.0)))
        for session in range(sessions):
            size = (1.0 + growth[k] * session) * (1.0 + rng.normal(0.0, scatter))
            rows.append(row(f"r{k:04d}", session, shape * size, batch=None if batches is None else batches[k]))
    return compared(rows)


def test_wear_is_the_growth_of_the_mean_width_and_its_sigma_has_the_scatter():
    rng = np.random.default_rng(5)
    truth = rng.uniform(-0.01, 0.03, 200)
    last = [each for each in fleet_of(rng, 200, truth, scatter=0.01) if each.session == "05"]
    # A line through log(1 + g k) is not quite g: less by g / 2 times the mean of k, here at most 0.001.
    off = np.array([each.wear for each in last]) - truth + 2.5 * truth**2
    sigma = np.array([each.wear_sigma for each in last])
    assert np.median(sigma) == pytest.approx(0.01 / np.sqrt(17.5), rel=0.1)  # 17.5: sum of squares of 0..5 about 2.5
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1.0, abs=0.15)  # 3 / sqrt(2 * 200)


def test_a_later_session_is_told_beside_the_first_usable_one():
    failed = Row("a", "00", "x", error="nothing")
    first, later = row("a", 1, 0.5), replace(row("a", 2, 0.55), c_deg=tuple((12.0 * (PLACES - 0.1)).tolist()))
    rows = compared([failed, first, later])
    assert rows[0].since is None and rows[1].since is None and rows[2].since == "01"
    assert rows[2].width_change == pytest.approx(0.1)
    assert rows[2].offset_change == pytest.approx(-0.1)  # the tip is where it was at q - 0.1
    assert rows[2].wear == pytest.approx(np.log(1.1))


@pytest.mark.parametrize("named", [True, False])
def test_a_worn_batch_of_a_few_is_found_and_no_other(named):
    rng = np.random.default_rng(11)
    worn = np.zeros(300, dtype=bool)
    worn[rng.permutation(300)[:9]] = True
    growth = np.where(worn, 0.05, 0.006) * rng.lognormal(0.0, 0.2, 300)
    batches = ["C3" if is_worn else f"A{k % 10}" for k, is_worn in enumerate(worn)] if named else None
    found = findings(fleet_of(rng, 300, growth, batches=batches))
    assert {each.name for each in found.worn} == {f"r{k:04d}" for k in np.flatnonzero(worn)}
    assert [each.name for each in found.worn_batches] == (["C3"] if named else [])


@pytest.mark.parametrize("seed", range(4))
def test_in_a_sound_fleet_nobody_is_worn_or_unlike(seed):
    rng = np.random.default_rng(100 + seed)
    found = findings(fleet_of(rng, 60, 0.006 * rng.lognormal(0.0, 0.3, 60)))
    assert found.worn == () and found.worn_batches == () and found.unlike == ()


def test_a_robot_of_another_shape_is_unlike():
    rng = np.random.default_rng(8)
    rows = fleet_of(rng, 60, np.zeros(60), sessions=1)
    strange = replace(rows[7], width=tuple((0.5 + 0.2 * np.sin(4.0 * PLACES)).tolist()))
    found = findings([*rows[:7], strange, *rows[8:]])
    assert [each.name for each in found.unlike] == ["r0007"]


def test_two_robots_are_no_fleet_and_nothing_is_said():
    found = findings(compared([row("a", 0, 0.5), row("b", 0, 0.7)]))
    assert (found.worn, found.unlike, found.drifting) == ((), (), ())


# ---- how a curve is spread


def drawn(rng, count, sigma, repeats=1):
    """Curves of a known normal distribution, each seen `repeats` times with errors."""
    apart = (PLACES[:, None] - PLACES[None, :]) / 3.0
    scale = 0.04 * (0.8 + 0.2 * np.exp(-0.5 * apart**2))
    truth = 0.5 + rng.multivariate_normal(np.zeros(33), scale, count)
    robot = np.repeat(np.arange(count), repeats)
    value = truth[robot] + rng.normal(0.0, sigma, (len(robot), 33))
    return Curves(PLACES, value, np.full(value.shape, sigma), tuple(f"r{k}" for k in robot)), scale


@pytest.mark.parametrize("sigma", [0.002, 0.2])
def test_the_spread_is_the_robots_without_the_sessions_errors(sigma):
    known, scale = drawn(np.random.default_rng(2), 120, sigma, repeats=2)
    found = population(known)
    # Of 120 robots the variance is known to sqrt(2 / 120), 13 %; a heavy tail's
    # scale is up to as much below its variance.
    assert np.trace(found.scale) == pytest.approx(np.trace(scale), rel=0.25)


def test_a_new_robot_is_as_far_off_as_the_spread_says():
    rng = np.random.default_rng(3)
    found = population(drawn(rng, 150, 0.002)[0])
    others = drawn(rng, 300, 0.002)[0]
    chance = found.chance(others.value, others.sigma)
    assert np.mean(chance < 0.1) == pytest.approx(0.1, abs=0.08)
