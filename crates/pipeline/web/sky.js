// The sky: an equirectangular picture on a large sphere seen from inside.

import * as pc from './playcanvas.mjs';

/** Shows a picture; the sphere is made once, then its texture is replaced. */
export function drawSky(player, image) {
    const device = player.app.graphicsDevice;
    const texture = new pc.Texture(device, { width: image.width, height: image.height, format: pc.PIXELFORMAT_RGBA8, mipmaps: false,
        addressU: pc.ADDRESS_REPEAT, addressV: pc.ADDRESS_CLAMP_TO_EDGE });
    texture.setSource(image);
    if (!player.dome) player.dome = makeDome(player);
    player.dome.material.setParameter('skyMap', texture);
    player.dome.texture?.destroy();
    player.dome.texture = texture;
}

function makeDome(player) {
    const { up, forward } = player.stream.manifest;
    const material = new pc.ShaderMaterial({
        uniqueName: 'ffgs-sky',
        attributes: { vertex_position: pc.SEMANTIC_POSITION },
        vertexGLSL: `
            attribute vec3 vertex_position;
            uniform mat4 matrix_view;
            uniform mat4 matrix_projection;
            varying vec3 direction;
            void main(void) {
                direction = vertex_position;
                vec4 p = matrix_projection * vec4(mat3(matrix_view) * vertex_position * 100.0, 1.0);
                gl_Position = p.xyww;
            }`,
        fragmentGLSL: `
            precision highp float;
            varying vec3 direction;
            uniform sampler2D skyMap;
            uniform vec3 skyUp;
            uniform vec3 skyForward;
            void main(void) {
                vec3 d = normalize(direction);
                float u = atan(dot(d, cross(skyForward, skyUp)), dot(d, skyForward)) / 6.28318530718 + 0.5;
                float v = acos(clamp(dot(d, skyUp), -1.0, 1.0)) / 3.14159265359;
                gl_FragColor = vec4(textureLod(skyMap, vec2(u, v), 0.0).rgb, 1.0);
            }`,
        vertexWGSL: `
            attribute vertex_position: vec3f;
            uniform matrix_view: mat4x4f;
            uniform matrix_projection: mat4x4f;
            varying direction: vec3f;
            @vertex fn vertexMain(input: VertexInput) -> VertexOutput {
                var output: VertexOutput;
                let view = mat3x3f(uniform.matrix_view[0].xyz, uniform.matrix_view[1].xyz, uniform.matrix_view[2].xyz);
                let p = uniform.matrix_projection * vec4f(view * input.vertex_position * 100.0, 1.0);
                output.direction = input.vertex_position;
                output.position = p.xyww;
                return output;
            }`,
        fragmentWGSL: `
            varying direction: vec3f;
            var skyMap: texture_2d<f32>;
            var skyMapSampler: sampler;
            uniform skyUp: vec3f;
            uniform skyForward: vec3f;
            @fragment fn fragmentMain(input: FragmentInput) -> FragmentOutput {
                var output: FragmentOutput;
                let d = normalize(input.direction);
                let u = atan2(dot(d, cross(uniform.skyForward, uniform.skyUp)), dot(d, uniform.skyForward)) / 6.28318530718 + 0.5;
                let v = acos(clamp(dot(d, uniform.skyUp), -1.0, 1.0)) / 3.14159265359;
                output.color = vec4f(textureSampleLevel(skyMap, skyMapSampler, vec2f(u, v), 0.0).rgb, 1.0);
                return output;
            }`,
    });
    material.setParameter('skyUp', up);
    material.setParameter('skyForward', forward);
    material.cull = pc.CULLFACE_NONE;
    material.depthWrite = false;
    const entity = new pc.Entity('sky');
    const mesh = pc.Mesh.fromGeometry(player.app.graphicsDevice, new pc.SphereGeometry({ radius: 1, latitudeBands: 24, longitudeBands: 48 }));
    const instance = new pc.MeshInstance(mesh, material);
    instance.cull = false;
    entity.addComponent('render', { meshInstances: [instance], layers: [pc.LAYERID_WORLD] });
    player.app.root.addChild(entity);
    return { entity, material };
}
