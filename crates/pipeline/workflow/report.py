"""One page over all runs of a workflow: table, curves over frames, a picture of each: report.py config.json > report.html."""

import html
import json
import sys
from pathlib import Path

import table

COLOURS = ["#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f"]
CURVES = {"psnr": "PSNR (dB)", "mpsnr": "PSNR of the foreground (dB)"}
WIDTH, HEIGHT, LEFT, MARGIN = 640, 260, 44, 24
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1400px; padding: 0 1rem; color: #1f2937 }
table { border-collapse: collapse } td, th { padding: .3rem .8rem; border-bottom: 1px solid #d1d5db; text-align: right }
td:first-child, th:first-child { text-align: left } .row { display: flex; flex-wrap: wrap; gap: 1.5rem }
figure { margin: 0 } figcaption { font-size: 13px } img { max-width: 440px; display: block } svg text { font-size: 11px }
svg .grid { stroke: #e5e7eb } svg .seam { stroke: #9ca3af; stroke-dasharray: 3 3 }
svg polyline { fill: none; stroke-width: 1.6 } .key { display: inline-block; width: .8em; height: .8em; margin-right: .4em }
"""


def means(metrics, key):
    """(frame, mean over the views that have the figure), test views or, where there are none, some that were trained on."""
    views = ((f["frame"], f["views"] or f.get("training_views", [])) for f in metrics["frames"])
    values = ((frame, [v[key] for v in of if v.get(key) is not None]) for frame, of in views)
    return [(frame, sum(of) / len(of)) for frame, of in values if of]


def plot(title, curves, seams):
    """One line per run over frames, and a dashed one at every seam."""
    points = [point for curve in curves.values() for point in curve]
    if not points:
        return ""
    first, last = min(x for x, _ in points), max(x for x, _ in points)
    low, high = min(y for _, y in points), max(y for _, y in points)
    low, high = low - 0.05 * (high - low) - 0.01, high + 0.05 * (high - low) + 0.01

    def x(frame):
        return LEFT + (frame - first) / max(last - first, 1) * (WIDTH - LEFT - MARGIN)

    def y(value):
        return MARGIN + (high - value) / (high - low) * (HEIGHT - 2 * MARGIN)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img"><title>{title}</title>']
    for step in range(5):
        value = low + step / 4 * (high - low)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - MARGIN}" y1="{y(value):.1f}" y2="{y(value):.1f}"/>')
        parts.append(f'<text x="{LEFT - 4}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.1f}</text>')
    for frame in sorted({first, (first + last) // 2, last}):
        parts.append(f'<text x="{x(frame):.1f}" y="{HEIGHT - 6}" text-anchor="middle">{frame}</text>')
    for frame in sorted(seams):
        at = f"{x(frame):.1f}"
        parts.append(f'<line class="seam" x1="{at}" x2="{at}" y1="{MARGIN}" y2="{HEIGHT - MARGIN}"/>')
    for colour, curve in curves.items():
        line = " ".join(f"{x(frame):.1f},{y(value):.1f}" for frame, value in curve)
        parts.append(f'<polyline stroke="{colour}" points="{line}"/>')
    return f"<figure><figcaption>{title}, by frame</figcaption>{''.join(parts)}</svg></figure>"


def picture(name, folder, root, frame):
    """The first test view of the last frame, from the run's own folder."""
    pictures = sorted((folder / "frames" / f"{frame:06d}" / "test").glob("*.png"))
    if not pictures:
        return ""
    source = html.escape(str(pictures[0].relative_to(root)))
    caption = html.escape(f"{name}: {pictures[0].stem}, frame {frame}")
    return f'<figure><a href="{source}"><img src="{source}" alt="{caption}"></a><figcaption>{caption}</figcaption></figure>'


def page(config):
    root = config.resolve().parent
    rows, pictures, seams = [], [], set()
    curves = {key: {} for key in CURVES}
    for number, (name, run) in enumerate(json.loads(config.read_text())["runs"].items()):
        of_run = table.Run(name, run, root)
        # Of more runs than colours, the later ones are told by their rows alone.
        colour = COLOURS[number] if number < len(COLOURS) else None
        key = f'<span class="key" style="background:{colour}"></span>' if colour else ""
        link = html.escape(str(of_run.folder.relative_to(root) / "report.html"))
        cells = "".join(f"<td>{cell}</td>" for cell in of_run.cells())
        rows.append(f'<tr><td>{key}<a href="{link}">{html.escape(name)}</a></td>{cells}</tr>')
        for figure in CURVES:
            if colour:
                curves[figure][colour] = means(of_run.metrics, figure)
        seams.update(seam["frame"] for seam in of_run.seams)
        pictures.append(picture(name, of_run.folder, root, of_run.metrics["frames"][-1]["frame"]))
    head = "".join(f"<th>{name}</th>" for name in table.HEAD)
    plots = "".join(plot(CURVES[key], curves[key], seams) for key in CURVES)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>fastflowgs: {len(rows)} runs</title>'
        f"<style>{STYLE}</style><h1>{len(rows)} runs</h1><table><tr>{head}</tr>{''.join(rows)}</table>"
        f'<h2>Over frames</h2><p>Means over the test views; of captures without any, over views that were trained on. Dashed: seams.</p><div class="row">{plots}</div>'
        f'<h2>Last frames</h2><div class="row">{"".join(pictures)}</div></html>'
    )


if __name__ == "__main__":
    print(page(Path(sys.argv[1])))
