"""The part of the benchmark on rigid bodies: its paths are those of a motion, and wrong answers are seen."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest

import ccd_warp as ccd

pytest.importorskip("ipctk")
pytest.importorskip("matplotlib")

from ccd_warp.benchmarks import (
    rigid,
    rigid_arm_scene,
    rigid_peers,
    rigid_scenes,
    rigid_sections,
    rigid_truth,
    rigid_turns,
)

SIZES = rigid.Sizes(8, 41, 64, (1e-3, 0.5), 16, 3, 8, 6, 1, 1.0)


@pytest.fixture(scope="module")
def steps() -> rigid_scenes.RigidSteps:
    """Steps of a tool past a plate, half of which end in contacts."""
    return rigid_truth.starting_apart(rigid_scenes.tool_and_plate(12))


@pytest.fixture(scope="module")
def toi(steps) -> np.ndarray:
    return rigid.ours(steps)[rigid.OURS]()


@pytest.mark.parametrize("make", rigid_scenes.SCENES, ids=lambda make: make.__name__)
def test_bodies_are_where_a_motion_has_them(make):
    steps = make(5)
    first, last = (poses[:, 0] for poses in rigid.matrices_of(steps))
    assert np.allclose(last[:, :3, 3] - first[:, :3, 3], steps.moves, atol=1e-12)
    poses = ccd.RigidMotion(first, last, path=steps.path).at(0.3)
    for k, pose in enumerate(poses):
        expected = steps.poses_at(k, np.array([0.3]))[0]
        assert np.allclose(rigid_scenes.matrix_of(pose[3:]), expected[:3, :3], atol=1e-12)
        assert np.allclose(pose[:3], expected[:3, 3], atol=1e-12)


def test_pairs_and_dice_are_where_a_motion_has_them():
    pairs = rigid_turns.Pairs.random("edge-edge", 2.0, 6)
    for each in (pairs, pairs.spinning(1.0)):
        poses = each.motion.at(0.0)
        placed = each.positions_at(0.0)
        for k, body in enumerate(each.parts):
            turns = np.stack([rigid_scenes.matrix_of(pose[3:]) for pose in poses[:, k]])
            here = body @ turns.transpose(0, 2, 1) + poses[:, k, None, :3]
            assert np.allclose(placed[:, 2 * k : 2 * k + 2], here, atol=1e-12)
    assert (pairs.on_arcs().world_toi < np.inf)[::2].all()  # every other pair is made to touch
    assert not (pairs.spinning(1.0).on_arcs().world_toi < pairs.spinning(0.0).on_arcs().world_toi).any()


def test_all_calls_of_ours_give_the_same_tois(steps, toi):
    assert 2 <= (toi < np.inf).sum() <= len(steps) - 2
    for name, call in rigid.ours(steps).items():
        assert np.allclose(call(), toi, atol=1e-9), name


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (lambda toi: toi, (0, 0, 0)),
        (lambda toi: np.full_like(toi, np.inf), (1, 0, 0)),
        (lambda toi: np.minimum(toi + 0.02, np.inf), (0, 1, 1)),
        (lambda toi: 0.5 * toi, (0, 0, 1)),
        (lambda toi: np.where(toi == np.inf, 0.5, toi), (0, 0, 1)),
    ],
    ids=["right", "missed", "late", "early", "phantom"],
)
def test_samples_see_what_is_wrong(steps, toi, change, seen):
    found = rigid_truth.evidence(steps, change(toi), 101)
    assert tuple(min(n, 1) for n in (found.missed, found.late, found.apart)) == seen


@pytest.mark.long  # says something of the benchmark alone
def test_steps_of_a_pair_are_counted_and_grow_with_its_turn():
    from ccd_warp.benchmarks import rigid_iterations  # compiles the solver of a pair

    few, many = rigid_iterations.measure("edge-edge", 24, (1e-3, 2.0))
    assert few["hit"]["pairs"] > 0 < few["free"]["pairs"]
    assert 1 <= few["free"]["mean"] < many["free"]["mean"]


def test_faults_of_others_are_counted():
    truth = np.array([0.2, 0.4, 0.5, np.inf, np.inf])
    assert rigid.judged(np.array([0.3, np.inf, np.inf, 0.1, np.inf]), truth) == {
        "hits": 2,
        "missed": 2,
        "phantom": 1,
        "late": 1,
        "error": pytest.approx(0.1),
    }
    assert rigid.judged(np.full(5, np.inf), truth)["error"] is None


def test_the_page_tells_what_is_missed_and_who_is_not_installed(monkeypatch):
    monkeypatch.setattr(rigid_peers, "find_spec", lambda module: None)
    from ccd_warp.benchmarks import rigid_arm, rigid_dice, rigid_iterations

    def steps_of(kind, count, turns):  # the kernel that counts takes seconds to compile
        steps = {"pairs": count, "mean": 2.5, "most": 7}
        return [{"turn": turn, "free": steps, "hit": steps} for turn in turns]

    monkeypatch.setattr(rigid_iterations, "measure", steps_of)
    monkeypatch.setattr(rigid_dice, "find_spec", lambda module: None)
    monkeypatch.setattr(rigid_arm, "find_spec", lambda module: None)
    monkeypatch.setattr(rigid_arm, "arm_edges", partial(rigid_arm.arm_edges, faces=500, obstacles=20))
    records = [call() for call in rigid.calls(SIZES).values()]
    assert [record["what"] for record in records] == 4 * ["steps"] + 2 * ["turns", "pairs"] + ["dice", "edges"]
    for record in records[:4]:
        assert (record["evidence"]["missed"], record["evidence"]["late"]) == (0, 0)
        assert len(record["rows"]) == 3 and record["versions"] == {}
        record["rows"][1]["missed"] = 3
    page = rigid_sections.rigid({"rigid": records}, ".")
    assert sum("| **3** |" in line for line in page) == 4
    assert sum("Not installed: python-fcl, coal, drake, py-parry3d" in line for line in page) == 4
    assert sum(line.startswith(("| vertex-face | 0.5 |", "| edge-edge | 0.001 |")) for line in page) == 2
    assert sum("6 edges" in line or "edges of a motion planner" in line for line in page) == 1
    rigid_sections.draw_turns({"rigid": records})


def test_the_parts_of_a_run_are_those_of_its_sizes():
    assert rigid.QUICK != rigid.FULL and set(rigid.QUICK.turns) <= set(rigid.FULL.turns)
    assert list(rigid.calls(rigid.QUICK)) == list(rigid.calls(rigid.FULL))


@pytest.mark.parametrize("name", rigid_peers.PEERS)
def test_a_peer_finds_what_is_easy_to_find(name, steps, monkeypatch):
    if find_spec(rigid_peers.PEERS[name]) is None:
        pytest.skip(f"{name} is not installed")
    others = {other: "no_such_module" for other in rigid_peers.PEERS if other != name}
    monkeypatch.setattr(rigid_peers, "PEERS", rigid_peers.PEERS | others)
    # the tool falls flat on the middle of the plate, or stays above it
    poses = np.tile([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], (2, 1))
    easy = replace(
        steps, poses=poses, omega=np.tile([0, 0, 1e-3], (2, 1)), moves=np.array([[0, 0, -0.06], [0.1, 0, 0]])
    )
    answers = {each: solve() for each, solve in rigid_peers.peers_of(easy)}
    assert answers
    for each, found in answers.items():
        is_right = (found < np.inf) == [True, False]
        assert is_right.all() or "fcl, advancement" in each or "fcl, defaults" in each, each


def test_links_of_the_arm_are_where_joints_have_them():
    edges = rigid_arm_scene.arm_edges(3, faces=200, obstacles=3)
    poses = edges.motion(slice(None)).at(0.3)
    matrices = edges.matrices_at(np.arange(3), np.full(3, 0.3))
    assert np.allclose(matrices[..., :3, 3], poses[..., :3], atol=1e-12)
    turns = [[rigid_scenes.matrix_of(pose[3:]) for pose in world] for world in poses]
    assert np.allclose(matrices[..., :3, :3], turns, atol=1e-12)
    assert np.allclose(np.linalg.norm(edges.q1 - edges.q0, axis=1), rigid_arm_scene.EDGE)


@pytest.mark.skipif(find_spec("fcl") is None, reason="python-fcl is not installed")
def test_a_sampler_of_configurations_finds_what_it_looks_at():
    from ccd_warp.benchmarks import rigid_arm

    edges = rigid_arm_scene.arm_edges(30, faces=200)
    mesh = edges.mesh.replicate(30)
    touches = rigid_arm.touching_at(edges, np.arange(30), np.full(30, 1.0), mesh)
    sampler = rigid_arm.Sampler(edges)
    ends = edges.matrices_at(np.arange(30), np.ones(30))
    assert touches.any() and not touches.all()
    assert [sampler.first(ends[k : k + 1]) == 0 for k in range(30)] == touches.tolist()
