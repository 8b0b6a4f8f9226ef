"""Converters and the layout they write; no network is needed."""

import json

import numpy as np
import pytest
from ffgs_trackers import networks
from ffgs_trackers.__main__ import main
from ffgs_trackers.flows import read_flo
from ffgs_trackers.layout import Capture, Tracker
from PIL import Image

FRAMES = 3


@pytest.fixture
def capture(tmp_path):
    root = tmp_path / "capture"
    names = [[f"{camera}/{frame:06d}.png" for camera in "ab"] for frame in range(FRAMES)]
    for name in sum(names, []):
        path = root / "ims" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (10, 6), (9, 8, int(path.stem))).save(path)
    (root / "train_meta.json").write_text(json.dumps({"fn": names}))
    return root


def entry(root, name):
    trackers = json.loads((root / "tracks/tracks.json").read_text())["trackers"]
    (found,) = [t for t in trackers if t["name"] == name]
    return found


def tracks(root, name, camera, frame):
    with np.load(root / f"tracks/{name}/{camera}/{frame:06d}.npz") as file:
        return file["src"], file["tgt"], file["visibility"]


def test_flows_are_kept_step_by_step(capture, tmp_path):
    flow = np.arange(6 * 10 * 2, dtype=np.float32).reshape(6, 10, 2)
    for camera in "ab":
        (tmp_path / "out" / camera).mkdir(parents=True)
        for step in range(2):
            np.savez(tmp_path / "out" / camera / f"{step:04d}.npz", flow=flow + step)
    main(["flows", str(capture), str(tmp_path / "out"), "--name", "gmflow"])
    for step in range(2):
        assert (read_flo(capture / f"tracks/gmflow/b/{step + 1:06d}.flo") == flow + step).all()
    assert entry(capture, "gmflow")["level"] == "dense" and entry(capture, "gmflow")["format"] == "flo"
    # What was written is read again, as files of GMFlow would be.
    main(["flows", str(capture), str(capture / "tracks/gmflow"), "--name", "again"])
    assert (read_flo(capture / "tracks/again/a/000002.flo") == flow + 1).all()


@pytest.mark.parametrize("kind", ["pairs", "indices"])
def test_matches_of_both_kinds(capture, tmp_path, kind):
    first, second = np.array([[1, 2], [3, 4], [5, 1]]), np.array([[7, 7], [1.5, 2], [5, 5]])
    matches = np.array([[0, 1], [2, 2]]) if kind == "pairs" else np.array([1, -1, 2])
    (tmp_path / "out/a").mkdir(parents=True)
    file = tmp_path / "out/a/000.npz"
    np.savez(file, keypoints0=first, keypoints1=second, matches=matches)
    main(["matches", str(capture), str(tmp_path / "out"), "--name", "lightglue"])
    source, target, _ = tracks(capture, "lightglue", "a", 1)
    assert (source == first[[0, 2]]).all() and (target == second[[1, 2]]).all()
    assert entry(capture, "lightglue")["level"] == "sparse"


def test_points_that_are_not_seen_start_no_track(capture, tmp_path):
    points = np.zeros((1, FRAMES, 2, 3), np.float32)
    points[0, :, 0, 0] = [1, 2, 4]
    points[0, :, 1, :2] = 3
    points[0, :, :, 2] = [[1, 1], [1, 0], [1, 1]]
    (tmp_path / "out").mkdir()
    np.savez(tmp_path / "out/a.npz", tracks=points)
    main(["points", str(capture), str(tmp_path / "out"), "--name", "dot"])
    source, target, visibility = tracks(capture, "dot", "a", 1)
    assert source[:, 0].tolist() == [1, 3] and target[:, 0].tolist() == [2, 3] and visibility.tolist() == [1, 0]
    source, target, _ = tracks(capture, "dot", "a", 2)
    assert source[:, 0].tolist() == [2] and target[:, 0].tolist() == [4]


def test_entries_of_other_trackers_stay(capture, tmp_path):
    (tmp_path / "out").mkdir()
    np.savez(tmp_path / "out/a.npz", pred_tracks=np.ones((FRAMES, 4, 2)))
    for name in ("one", "two", "one"):
        main(["points", str(capture), str(tmp_path / "out"), "--name", name])
    trackers = json.loads((capture / "tracks/tracks.json").read_text())["trackers"]
    assert sorted(t["name"] for t in trackers) == ["one", "two"]


def test_a_network_is_given_padded_images_and_cut_to_size(capture):
    opened = Capture(capture)
    tracker = Tracker(opened, "net", "dense")
    sizes = set()

    def flow(before, now):
        sizes.add(before.shape)
        return np.full((*before.shape[:2], 2), now[0, 0, 2] - before[0, 0, 2], np.float32)

    networks.run(opened, tracker, flow)
    assert sizes == {(8, 16, 3)} and tracker.files == 4
    assert (read_flo(tracker.path("a", 2)) == np.ones((6, 10, 2))).all()


@pytest.mark.parametrize(
    ("arrays", "message"),
    [({"wrong": np.zeros(3)}, "no array tracks"), ({"tracks": np.zeros((3, 4))}, "shape (3, 4)")],
)
def test_errors_name_the_file(capture, tmp_path, arrays, message):
    (tmp_path / "out").mkdir()
    np.savez(tmp_path / "out/a.npz", **arrays)
    with pytest.raises(SystemExit) as raised:
        main(["points", str(capture), str(tmp_path / "out"), "--name", "dot"])
    assert message in str(raised.value) and "a.npz" in str(raised.value)
    assert not (capture / "tracks").exists()


def test_a_folder_without_the_cameras_writes_no_entry(capture, tmp_path):
    with pytest.raises(SystemExit, match="no file of any camera"):
        main(["flows", str(capture), str(tmp_path), "--name", "gmflow"])
    assert not (capture / "tracks/tracks.json").exists()
