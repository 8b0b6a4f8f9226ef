// How much is drawn: less while something moves and pictures are slow, everything at rest.

/** Milliseconds per picture above which less is drawn, and below which more: 20 pictures per second are wanted. */
const SLOW = 50;
const FAST = 38;
/** Milliseconds per picture that a new limit is meant to lead to. */
const WANTED = 43;
/** Milliseconds without motion after which everything is drawn. */
const REST = 350;
/** Pictures, or milliseconds, that are timed before the limit changes; pictures after a change are not. */
const TIMED = 5;
const ENOUGH = 300;
const SETTLING = 2;
/** A limit changes by at most this factor at a time, and is at least so many splats. */
const STEP = 2;
const LEAST = 5000;
/** Shares of the resolution where not everything is drawn: with so few splats or fewer the second, from so many on the first again. */
const PIXELS = [0.5, 0.25];
const FEW = 15000;
const MANY = 40000;
/** Milliseconds until everything is tried again in motion, doubled with each time that it was too slow. */
const RETRY = 10000;

/** Splats to begin with where the processor draws. */
const IN_SOFTWARE = 10000;

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

/** Decides from the times of pictures. `limit` is the most splats that are drawn in motion, infinite while everything is fast enough. */
export class Quality {
    constructor(inSoftware = false) {
        Object.assign(this, { first: inSoftware ? IN_SOFTWARE : Infinity, stillSince: -Infinity, rests: true });
        this.choose('auto');
    }

    /** Begins anew with a setting, as if no picture had been timed. */
    choose(setting) {
        Object.assign(this, { setting, limit: this.first, few: this.first < FEW, retry: RETRY, retryAt: 0 });
        this.restart();
    }

    /** Forgets times: those that follow are of other pictures. */
    restart() {
        this.times = [];
        this.skip = SETTLING;
    }

    /** Says at each tick whether something moves. */
    tick(now, moves) {
        if (moves && this.rests) this.restart();
        if (moves) this.stillSince = Infinity;
        else this.stillSince = Math.min(this.stillSince, now);
        this.rests = now - this.stillSince > REST;
    }

    /** Splats that may be drawn now. */
    get budget() {
        return this.setting === 'full' || (this.setting === 'auto' && this.rests) ? Infinity : this.limit;
    }

    /** Share of the resolution. */
    get pixels() {
        return this.budget === Infinity ? 1 : PIXELS[this.few ? 1 : 0];
    }

    /** A picture of so many splats took so many milliseconds; `seen` is how many are in the picture. */
    drawn(now, time, splats, seen) {
        if (this.rests || this.setting === 'full' || this.skip-- > 0) return;
        this.times.push(time);
        if (this.times.length < TIMED && this.times.reduce((a, b) => a + b) < ENOUGH) return;
        const limit = this.next(now, median(this.times), splats, seen);
        this.times = [];
        if (limit !== this.limit) this.restart();
        this.limit = limit;
        this.few = limit < FEW || (this.few && limit < MANY);
    }

    /** The limit after pictures that took so long. */
    next(now, time, splats, seen) {
        const ratio = WANTED / time;
        if (this.limit === Infinity) {
            if (time <= SLOW) return Infinity;
            [this.retryAt, this.retry] = [now + this.retry, 2 * this.retry];
            // The resolution alone saves no more than its square.
            return this.clamp(seen * Math.max(1 / 8, Math.min(1, ratio / PIXELS[0] ** 2)), seen);
        }
        if (time > SLOW) return this.clamp(splats * Math.max(1 / STEP, ratio), seen);
        if (time >= FAST) return this.limit;
        if (splats >= seen) return now > this.retryAt ? Infinity : this.limit;
        return this.clamp(splats * Math.min(STEP, ratio), seen);
    }

    clamp(limit, seen) {
        return Math.max(LEAST, Math.min(seen, Math.round(limit)));
    }
}
