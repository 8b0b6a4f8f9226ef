"""The package on the sample, on the conformance stream and on made-up arrays.

FFGS names the program `ffgs`; without it the comparison with its pictures is skipped.
"""

import json
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import fastflowgs
import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ROOT / "fixtures/scenes/fairmont-mini"
STREAM = ROOT / "fixtures/reference/stream"
NOTEBOOK = ROOT / "crates/python/notebooks/pictures.ipynb"


@pytest.fixture(scope="module")
def capture():
    return fastflowgs.Capture(SAMPLE)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    settings = {"device": "cpu", "frames": "0..2", "first_iterations": 30, "iterations": 5, "static_iterations": 2}
    return fastflowgs.reconstruct(SAMPLE, out, quiet=True, **settings)


def psnr(image, truth, where):
    error = (image - truth / 255)[where]
    return -10 * np.log10(np.mean(error**2))


def test_a_capture_has_cameras_photographs_and_masks(capture):
    view = capture.views("train")[0]
    camera, image, mask = capture.camera(view, 1), capture.image(view, 1), capture.mask(view, 1)
    assert image.shape == (camera["height"], camera["width"], 3) and image.dtype == np.uint8
    assert mask.shape == image.shape[:2] and set(np.unique(mask)) <= {0, 1}
    rotation = camera["camera_from_world"][:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    points = capture.points()
    assert len(points["positions"]) == len(points["colours"]) == len(points["foreground"])
    with pytest.raises(ValueError, match="no view"):
        capture.camera("nobody", 0)
    with pytest.raises(IndexError, match="frames"):
        capture.camera(view, 99)


def test_errors_name_the_file(tmp_path):
    for kind in [fastflowgs.Capture, fastflowgs.Run, fastflowgs.Stream]:
        with pytest.raises(fastflowgs.Error, match=str(tmp_path)):
            kind(tmp_path)


def test_frames_of_a_run_are_read_and_look_like_the_photographs(run, capture):
    assert run.capture == SAMPLE and run.frames == [0, 1] and len(run) == 2
    view = capture.views("train")[0]
    for frame in run:
        n = len(frame.dynamic["means"])
        assert frame.dynamic["covariances"].shape == (n, 3, 3) and len(set(frame.dynamic["ids"])) == n
        colours, opacity = frame.render(capture.camera(view, frame.index))
        assert psnr(colours, capture.image(view, frame.index), opacity > 0.99) > 15
    with pytest.raises(KeyError, match="not finished"):
        run[7]


@pytest.fixture
def interruptible():
    """Python's own handler: a shell's background jobs, and what they start, ignore interrupts from the keyboard."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_ends_a_run_after_the_frame_at_work(tmp_path):
    out = tmp_path / "out"
    # Frames that take a second each: on a busy machine the signal may come late.
    settings = {"device": "cpu", "quiet": True, "first_iterations": 10, "iterations": 200, "static_iterations": 2}
    settings["train_views"] = "trk000,trk004,trk008"

    def interrupt():
        while not (out / "frames/000000/state.ffgs").exists():
            time.sleep(0.005)
        os.kill(os.getpid(), signal.SIGINT)

    watcher = threading.Thread(target=interrupt)
    watcher.start()
    with pytest.raises(KeyboardInterrupt):
        fastflowgs.reconstruct(SAMPLE, out, frames="0..6", **settings)
    watcher.join()
    finished = len(fastflowgs.Run(out))
    assert 1 <= finished < 6 and (out / "report.html").exists()
    assert len(fastflowgs.reconstruct(SAMPLE, out, frames="0..6", resume=True, **settings)) == 6


def test_a_view_is_the_picture_of_the_program(run, capture, tmp_path):
    if "FFGS" not in os.environ:
        pytest.skip("FFGS does not name the program")
    view = capture.views("test")[0]
    words = ["--frame", "1", "--camera", view, "--device", "cpu", "--out", tmp_path]
    subprocess.run([os.environ["FFGS"], "render", run.path, *words], check=True)
    theirs = np.asarray(Image.open(tmp_path / f"{view}_000001.png")).astype(int)
    ours = np.round(run[1].render(capture.camera(view, 1))[0].clip(0, 1) * 255).astype(int)
    assert np.abs(ours - theirs).max() <= 1
    plain, opacity = run[1].render(capture.camera(view, 1), background=[1, 0, 1])
    seen_through = opacity < 0.01
    assert seen_through.any() and np.allclose(plain[seen_through], [1, 0, 1], atol=0.03)


def test_a_run_and_its_stream_look_alike(run, capture, tmp_path):
    if "FFGS" not in os.environ:
        pytest.skip("FFGS does not name the program")
    subprocess.run([os.environ["FFGS"], "export", run.path, "--to", "stream", "--out", tmp_path], check=True)
    stream = fastflowgs.Stream(tmp_path)
    assert stream.frames == run.frames and stream.frames_per_second == 30
    camera = capture.camera(capture.views("test")[0], 1)
    ours, theirs = (source[1].render(camera)[0] for source in [run, stream])
    assert -10 * np.log10(np.mean((ours - theirs) ** 2)) > 28


def test_a_stream_is_read_in_order_and_at_random(capture):
    stream = fastflowgs.Stream(STREAM)
    counts = [json.loads(line)["gaussians"] for line in (STREAM / "frames.jsonl").read_text().splitlines()]
    in_order = list(stream)
    assert [[len(f.static["means"]), len(f.dynamic["means"])] for f in in_order] == counts
    for index in [5, 1, 6, 0]:
        assert np.array_equal(stream[index].static["means"], in_order[index].static["means"])
    camera = capture.camera(capture.views("test")[0], 0)
    colours, opacity = in_order[0].render(camera, background=[0, 0, 0])
    assert np.isfinite(colours).all() and opacity.min() >= 0
    # The sky of the conformance stream is no picture.
    with pytest.raises(fastflowgs.Error, match="sky"):
        in_order[0].render(camera)
    with pytest.raises(fastflowgs.Error, match="no frame 77"):
        stream[77]
    with pytest.raises(fastflowgs.Error, match="stream cannot be finetuned"):
        in_order[0].finetune(capture, 1)


def test_a_frame_is_trained_and_the_next_one_finetuned_from_it(capture):
    first = fastflowgs.train_first_frame(capture, iterations=40, seed=1)
    start = first.dynamic["means"]
    assert len(start) and len(first.static["means"])
    lost = first.finetune(capture, 1, means=start + np.array([0, 0, 50.0]), iterations=0)
    assert np.allclose(lost.dynamic["means"], start + np.array([0, 0, 50.0]), atol=1e-4)
    view = capture.views("train")[3]
    camera, truth = capture.camera(view, 1), capture.image(view, 1)
    cars = capture.mask(view, 1) == 1
    before, after = (f.render(camera)[0] for f in [first, first.finetune(capture, 1, iterations=60)])
    assert psnr(after, truth, cars) > psnr(before, truth, cars) + 0.2
    with pytest.raises(ValueError, match="shape"):
        first.finetune(capture, 1, means=start[:5])
    with pytest.raises(IndexError, match="frames"):
        first.finetune(capture, 99)


def test_other_threads_run_while_a_frame_is_trained(capture):
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.02)

    thread = threading.Thread(target=tick)
    thread.start()
    start = time.monotonic()
    fastflowgs.train_first_frame(capture, iterations=10)
    end = time.monotonic()
    done.set()
    thread.join()
    assert sum(start < t < end for t in ticks) >= 5


def test_a_stage_finds_a_point_that_three_cameras_see():
    point = np.array([0.1, 0.2, 4.1])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [-1, 0, 1]
    seen = [pose[:3, :3] @ point + pose[:3, 3] for pose in poses]
    targets = np.array([[600 * s[:2] / s[2] + [320, 240]] for s in seen])
    cameras = {"intrinsics": np.tile([600.0, 600.0, 320.0, 240.0], (3, 1)), "camera_from_world": poses}
    means = np.array([[0.0, 0.0, 4.0]])
    out = fastflowgs.stage("triangulate", means=means, targets=targets, weights=np.ones((3, 1)), **cameras)
    assert out["valid"].all() and np.allclose(out["means"][0], point, atol=1e-4)
    with pytest.raises(ValueError):
        fastflowgs.stage("guess")
    with pytest.raises(fastflowgs.Error, match="targets"):
        fastflowgs.stage("triangulate", means=means, **cameras)


def test_tracks_become_a_motion_field_and_are_fused():
    src = np.array([[4.0, 4.0], [12.0, 4.0], [8.0, 12.0]])
    tracks = {"src": src, "tgt": src + [2.0, 1.0], "visibility": np.ones(3)}
    field = fastflowgs.stage("voronoi", **tracks, size=[16, 16], k=3, sigma=8.0)
    assert np.allclose(field["flow"], [2.0, 1.0], atol=1e-4)
    flow, confidence = np.stack([field["flow"]] * 2), np.stack([field["confidence"]] * 2)
    agreed = fastflowgs.stage("agreement", flow=flow, confidence=confidence, magnitude_floor=1.0)
    assert agreed["confidence"].shape == (2, 16, 16) and agreed["confidence"].max() > 0.5
    seen = {"means": np.array([[[0.0, 0, 0]], [[2.0, 0, 0]]]), "covariances": np.tile(np.eye(3), (2, 1, 1, 1)), "valid": np.ones((2, 1))}
    fused = fastflowgs.stage("fuse", prior_means=[[1.0, 0, 0]], prior_covariances=[np.eye(3) * 100], **seen)
    assert np.allclose(fused["means"][0], [1.0, 0, 0], atol=0.05)


def test_the_notebook_makes_its_pictures(run, tmp_path, monkeypatch):
    monkeypatch.setenv("FFGS_RUN", str(run.path))
    monkeypatch.setenv("FFGS_PICTURES", str(tmp_path))
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells)
    names = {}
    for cell in cells:
        exec("".join(cell["source"]), names)
    assert Image.open(tmp_path / "sample.jpg").size == Image.open(tmp_path / "orbit.jpg").size[:1] + (2 * 180,)
