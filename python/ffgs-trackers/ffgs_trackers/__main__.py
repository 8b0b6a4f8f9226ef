"""The command line: ffgs-trackers COMMAND CAPTURE …"""

import argparse
import sys

from . import flows, matches, networks, points
from .layout import Capture, LayoutError, Tracker

CONVERTERS = {
    "flows": (flows.convert, "dense", "converts flow files (GMFlow): FOLDER/CAMERA/*.flo or .npz"),
    "matches": (matches.convert, "sparse", "converts matches (LightGlue, SuperGlue): FOLDER/CAMERA/*.npz or .pt"),
    "points": (points.convert, "medium", "converts followed points (DOT, CoTracker): FOLDER/CAMERA.npz or .pt"),
}


def parser():
    out = argparse.ArgumentParser(prog="ffgs-trackers", description=__doc__)
    commands = out.add_subparsers(dest="command", required=True)

    def command(name, text, default_name=None):
        sub = commands.add_parser(name, help=text, description=text)
        sub.add_argument("capture", metavar="CAPTURE", help="folder of the capture; files are added to its tracks")
        sub.add_argument("--name", default=default_name, required=default_name is None, help="name of the tracker")
        return sub

    for name, (_, _, text) in CONVERTERS.items():
        sub = command(name, text)
        sub.add_argument("folder", metavar="FOLDER", help="output of the tracker; names as the capture's cameras")
        centre = "where the tracker puts the centre of the first pixel: 0, 0 (integer) or 0.5, 0.5 (half)"
        sub.add_argument("--pixel-center", choices=["integer", "half"], default="integer", help=centre)
    command("raft", "runs torchvision's RAFT", "raft")
    sub = command("onnx", "runs a flow network that was exported to ONNX")
    sub.add_argument("model", metavar="MODEL", help="two images (1, 3, H, W) in, flow (1, 2, H, W) out")
    sub.add_argument("--scale", type=float, default=1.0, help="factor on the values 0 to 255 of an image")
    sub.add_argument("--offset", type=float, default=0.0, help="added to them afterwards")
    return out


def run(args):
    capture = Capture(args.capture)
    if args.command in CONVERTERS:
        convert, level, _ = CONVERTERS[args.command]
        tracker = Tracker(capture, args.name, level, args.pixel_center)
        convert(capture, args.folder, tracker)
    else:
        tracker = Tracker(capture, args.name, "dense")
        network = networks.raft() if args.command == "raft" else networks.onnx(args.model, args.scale, args.offset)
        networks.run(capture, tracker, network)
    tracker.register()
    print(f"{tracker.name}: {tracker.files} files for {len(capture.cameras())} cameras")


def main(words=None):
    try:
        run(parser().parse_args(words))
    except (LayoutError, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
