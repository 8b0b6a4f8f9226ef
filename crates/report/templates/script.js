"use strict";
const at = (id) => document.getElementById(id);
const names = [...new Set(frames.flatMap((f) => f.views.map((v) => v.name)))];
const state = { frame: 0, view: 0, timer: null };
const FRAME_MILLISECONDS = 250;
const TURN_MILLISECONDS = 120;

function picture(img, source) {
  img.closest("figure").style.visibility = source ? "visible" : "hidden";
  if (source) img.src = source;
}

function score(label, value, digits, unit) {
  return value == null ? "" : `${label} ${value.toFixed(digits)}${unit}`;
}

// Parsed when a frame is first shown; a frame may have none.
function picturesOf(frame) {
  const data = at(`pictures-${frame.index}`);
  frame.parsed ??= data ? JSON.parse(data.textContent) : { views: [] };
  return frame.parsed;
}

function whyNone(frame) {
  if (!frame.dynamic_gaussians) return "no Gaussian of it moves";
  return state.frame ? "its masks are empty" : "nothing moves before the second frame";
}

function show() {
  const frame = frames[state.frame];
  const place = frame.views.findIndex((v) => v.name === names[state.view]);
  const view = frame.views[place];
  const pictures = picturesOf(frame);
  const images = pictures.views[place];
  at("frame").value = state.frame;
  at("view").value = state.view;
  at("frame-name").textContent = `frame ${frame.index} (${state.frame + 1} of ${frames.length})`;
  [0, 1, 2].forEach((i) => picture(at(`image-${i}`), images && images[i]));
  const scores = view ? [score("PSNR", view.psnr, 2, " dB"), score("MPSNR", view.mpsnr, 2, " dB"),
    score("SSIM", view.ssim, 4, ""), score("VMAF", view.vmaf, 1, ""), score("flicker", view.flicker, 2, "")] : names.length ? ["not in this frame"] : [];
  at("scores").textContent = scores.filter(Boolean).join(" · ");
  const none = !pictures.motion && !pictures.uncertainty;
  at("pair").hidden = none;
  at("no-pair").hidden = !none;
  at("no-pair").textContent = `This frame has no motion or uncertainty picture (${whyNone(frame)}).`;
  picture(at("motion"), pictures.motion);
  picture(at("uncertainty"), pictures.uncertainty);
}

function step(key, by, count) {
  if (count > 0) state[key] = (state[key] + by + count) % count;
  show();
}

function play() {
  if (state.timer) clearInterval(state.timer);
  state.timer = state.timer ? null : setInterval(() => step("frame", 1, frames.length), FRAME_MILLISECONDS);
  at("play").textContent = state.timer ? "❚❚ Pause" : "▶ Play";
}

function start() {
  names.forEach((name, i) => at("view").add(new Option(name, i)));
  at("frame").max = frames.length - 1;
  at("frame").addEventListener("input", (e) => { state.frame = Number(e.target.value); show(); });
  at("view").addEventListener("change", (e) => { state.view = Number(e.target.value); show(); });
  at("play").addEventListener("click", play);
  document.addEventListener("keydown", (e) => {
    const keys = { ArrowLeft: ["frame", -1, frames.length], ArrowRight: ["frame", 1, frames.length],
      ArrowUp: ["view", -1, names.length], ArrowDown: ["view", 1, names.length] };
    if (e.target.id.startsWith("turn")) return;
    if (e.key === " " && e.target.id !== "play") { e.preventDefault(); play(); }
    if (keys[e.key]) { e.preventDefault(); step(...keys[e.key]); }
  });
  // The second frame is the first that shows motion.
  state.frame = frames.length > 1 ? 1 : 0;
  show();
}

// A circle around what moves in one frame.
function turntable() {
  const data = at("turntable-data");
  const { frame, pictures } = data ? JSON.parse(data.textContent) : { pictures: [] };
  if (!pictures.length) return;
  let timer = null;
  const turn = (to) => {
    at("turn-at").value = to;
    at("turn-image").src = pictures[to];
    at("turn-name").textContent = `frame ${frame}, ${Math.round((360 * to) / pictures.length)}°`;
  };
  at("turn-at").max = pictures.length - 1;
  at("turn-at").addEventListener("input", (e) => turn(Number(e.target.value)));
  at("turn").addEventListener("click", () => {
    if (timer) clearInterval(timer);
    timer = timer ? null : setInterval(() => turn((Number(at("turn-at").value) + 1) % pictures.length), TURN_MILLISECONDS);
    at("turn").textContent = timer ? "❚❚ Pause" : "▶ Turn";
  });
  at("turntable").hidden = false;
  turn(0);
}

// Masks, points and tracks of the training cameras; the pictures are decoded when the section is opened.
function cameras() {
  const data = at("cameras-data");
  const { frame, cameras: all } = data ? JSON.parse(data.textContent) : { cameras: [] };
  if (!all.length) return;
  at("cameras-frame").textContent = `${frame} (${all.length})`;
  at("cameras").querySelector("details").addEventListener("toggle", () => {
    if (at("cameras-gallery").children.length) return;
    for (const { name, picture: source } of all) {
      const figure = document.createElement("figure");
      const img = document.createElement("img");
      Object.assign(img, { src: source, alt: name });
      const caption = document.createElement("figcaption");
      caption.textContent = name;
      figure.append(img, caption);
      at("cameras-gallery").append(figure);
    }
  });
  at("cameras").hidden = false;
}

turntable();
cameras();
if (frames.length) start(); else at("viewer").hidden = true;
