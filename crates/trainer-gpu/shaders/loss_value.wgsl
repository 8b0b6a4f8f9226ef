// Running means of the loss and the squared error, by one workgroup: nothing has to be read back in a step.
// Floor: 48 B per tile.
//
// twin: trainer::view::Running
// test: trainer-gpu/src/tests.rs::the_loss_and_its_gradient_agree
// bench: kernel/loss_value

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read> sums: array<vec4f>;
// Running means of the loss and of the squared error; number of steps; the last step's SSIM.
@group(0) @binding(2) var<storage, read_write> progress: array<f32, 4>;

// Weight of the newest step: an average over some twenty views.
const RATE: f32 = 0.05;

var<workgroup> partial: array<vec3f, 256>;

@compute @workgroup_size(256)
fn loss_value(@builtin(local_invocation_index) local: u32) {
    var sum = vec3f(0.0);
    for (var i = local; i < loss.slots * 3u; i += 256u) {
        sum += sums[i].xyz;
    }
    partial[local] = sum;
    workgroupBarrier();
    for (var step = 128u; step > 0u; step /= 2u) {
        if local < step {
            partial[local] += partial[local + step];
        }
        workgroupBarrier();
    }
    if local == 0u && loss.per_sample > 0.0 {
        let mean = partial[0] * loss.per_sample;
        let value = 0.8 * mean.y + 0.2 * (1.0 - mean.x);
        let rate = select(RATE, 1.0, progress[2] == 0.0);
        progress[0] += rate * (value - progress[0]);
        progress[1] += rate * (mean.z - progress[1]);
        progress[2] += 1.0;
        progress[3] = mean.x;
    }
}
