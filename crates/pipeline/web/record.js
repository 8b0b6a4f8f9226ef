// What the canvas shows, as a WebM video to be saved.

/** The first of these that the browser can write. */
const TYPES = ['video/webm;codecs=vp9', 'video/webm;codecs=vp8', 'video/webm'];
const FRAMES_PER_SECOND = 30;
const BITS_PER_SECOND = 12e6;

function save(blob, name) {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** Starts to record a canvas, or gives nothing where the browser cannot. `stop()` saves the video under a name. */
export function record(canvas, name) {
    const type = globalThis.MediaRecorder && TYPES.find((t) => MediaRecorder.isTypeSupported(t));
    if (!type || !canvas.captureStream) return null;
    const recorder = new MediaRecorder(canvas.captureStream(FRAMES_PER_SECOND), { mimeType: type, videoBitsPerSecond: BITS_PER_SECOND });
    const parts = [];
    recorder.ondataavailable = (e) => parts.push(e.data);
    recorder.onstop = () => save(new Blob(parts, { type: 'video/webm' }), `${name}.webm`);
    recorder.start(1000);
    return recorder;
}
