// Splats drawn by WebGL 2: one triangle for each, from the farthest to the nearest. Triangles are
// not instances: software devices draw each instance as slowly as a whole mesh.

/** Splats in a row of the texture that holds them; each has two texels. */
const ROW_SPLATS = 1024;
/** Slots for the background and agents. */
export const SLOTS = 256;
const TEXELS = 2;

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D splats, order;
uniform highp sampler2D slots;
uniform vec2 focal, size, middle, limit;
uniform float near, faintest;
uniform bool antialias;
out vec2 at;
flat out vec4 color;
// A triangle around the unit circle.
const vec2 CORNERS[3] = vec2[3](vec2(0, 2), vec2(-1.7320508, -1), vec2(1.7320508, -1));
const float DILATION_PX2 = 0.3;

void main() {
  gl_Position = vec4(0, 0, 2, 1);
  int place = gl_VertexID / 3;
  uint item = texelFetch(order, ivec2(place % ${ROW_SPLATS}, place / ${ROW_SPLATS}), 0).x;
  int splat = int(item & 0xffffffu), slot = int(item >> 24);
  ivec2 cell = ivec2(${TEXELS} * (splat % ${ROW_SPLATS}), splat / ${ROW_SPLATS});
  uvec4 one = texelFetch(splats, cell, 0), two = texelFetch(splats, cell + ivec2(1, 0), 0);
  vec4 x = texelFetch(slots, ivec2(0, slot), 0);
  vec4 y = texelFetch(slots, ivec2(1, slot), 0);
  vec4 z = texelFetch(slots, ivec2(2, slot), 0);
  vec4 mean = vec4(uintBitsToFloat(one.xyz), 1);
  vec3 seen = vec3(dot(x, mean), dot(y, mean), dot(z, mean));
  if (!(seen.z > near)) return;
  color = vec4(uvec4(one.w, one.w >> 8, one.w >> 16, one.w >> 24) & 255u) / 255.0;
  vec2 s = unpackSnorm2x16(two.x), t = unpackSnorm2x16(two.y);
  vec3 deviation = exp(32.0 * vec3(s, t.x));
  vec3 q = vec3(t.y, unpackSnorm2x16(two.z));
  float w = sqrt(max(0.0, 1.0 - dot(q, q)));
  // Twice the products of the quaternion's parts.
  vec3 d = 2.0 * q * q, o = 2.0 * q.xxy * q.yzz, v = 2.0 * w * q;
  mat3 turn = mat3(1.0 - d.y - d.z, o.x + v.z, o.y - v.y, o.x - v.z, 1.0 - d.x - d.z, o.z + v.x, o.y + v.y, o.z - v.x, 1.0 - d.x - d.y);
  vec2 slope = clamp(seen.xy / seen.z, -limit, limit);
  vec2 scale = focal / seen.z;
  // Rows of the Jacobian times the rotation to the camera.
  vec3 across = (scale.x * (x.xyz - slope.x * z.xyz)) * turn * deviation;
  vec3 down = (scale.y * (y.xyz - slope.y * z.xyz)) * turn * deviation;
  float a = dot(across, across), b = dot(across, down), c = dot(down, down);
  float before = a * c - b * b;
  a += DILATION_PX2;
  c += DILATION_PX2;
  if (antialias) color.a *= sqrt(max(0.0, before) / (a * c - b * b));
  if (color.a * 255.0 < faintest) return;
  float mean2 = 0.5 * (a + c), apart = length(vec2(0.5 * (a - c), b));
  float large = mean2 + apart, small = max(mean2 - apart, DILATION_PX2);
  vec2 axis = abs(b) > 1e-6 ? normalize(vec2(b, large - a)) : (a >= c ? vec2(1, 0) : vec2(0, 1));
  // Where the alpha falls below the faintest that is drawn.
  float reach = sqrt(2.0 * log(255.0 * color.a / faintest));
  at = reach * CORNERS[gl_VertexID % 3];
  vec2 center = focal * seen.xy / seen.z + middle;
  vec2 pixel = center + at.x * sqrt(large) * axis + at.y * sqrt(small) * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0, 1);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
flat in vec4 color;
out vec4 light;

void main() {
  float alpha = min(0.99, color.a * exp(-0.5 * dot(at, at)));
  if (alpha < 1.0 / 255.0) discard;
  light = vec4(alpha * color.rgb, alpha);
}`;

function compiled(gl, kind, text) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  return shader;
}

function linked(gl) {
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program);
  return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
}

function texture(gl) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER].forEach((name) => gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST));
  [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T].forEach((name) => gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE));
  return made;
}

/** A canvas, and splats of one source on its device. */
export class SplatCanvas {
  /** A canvas; null where the browser has no WebGL 2. */
  static create() {
    const element = document.createElement("canvas");
    const gl = element.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    const program = gl && linked(gl);
    return program ? new SplatCanvas(element, gl, program) : null;
  }

  constructor(element, gl, program) {
    Object.assign(this, { element, gl, count: 0 });
    gl.useProgram(program);
    this.at = Object.fromEntries(
      ["splats", "slots", "order", "focal", "size", "middle", "limit", "near", "faintest", "antialias"].map((name) => [name, gl.getUniformLocation(program, name)]),
    );
    gl.bindVertexArray(gl.createVertexArray());
    gl.activeTexture(gl.TEXTURE1);
    texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, 3, SLOTS);
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(this.at.splats, 0);
    gl.uniform1i(this.at.slots, 1);
    gl.uniform1i(this.at.order, 2);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Makes room for `count` splats, and forgets those that were there. False if there is none. */
  reserve(count) {
    const { gl } = this;
    const rows = Math.max(1, Math.ceil(count / ROW_SPLATS));
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) return false;
    this.textures?.forEach((old) => gl.deleteTexture(old));
    gl.activeTexture(gl.TEXTURE2);
    const order = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, ROW_SPLATS, rows);
    gl.activeTexture(gl.TEXTURE0);
    this.textures = [order, texture(gl)];
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, TEXELS * ROW_SPLATS, rows);
    this.ordered = new Uint32Array(ROW_SPLATS * rows);
    this.count = 0;
    return true;
  }

  /** Copies splats to the device: 8 words each, from the place `first` on. */
  add(first, words) {
    const { gl } = this;
    let [splat, from] = [first, 0];
    while (from < words.length) {
      const column = splat % ROW_SPLATS;
      const left = (words.length - from) / 8;
      // Whole rows at once, or a piece of one.
      const [wide, high] = column === 0 && left >= ROW_SPLATS ? [ROW_SPLATS, Math.floor(left / ROW_SPLATS)] : [Math.min(left, ROW_SPLATS - column), 1];
      const part = words.subarray(from, from + 8 * wide * high);
      const row = Math.floor(splat / ROW_SPLATS);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, TEXELS * column, row, TEXELS * wide, high, gl.RGBA_INTEGER, gl.UNSIGNED_INT, part);
      splat += wide * high;
      from += part.length;
    }
  }

  /** Sets the order in which splats are drawn: each with its slot in the upper 8 bits. */
  order(sorted) {
    const { gl } = this;
    this.count = Math.min(sorted.length, this.ordered.length);
    this.ordered.set(sorted.subarray(0, this.count));
    const rows = Math.ceil(this.count / ROW_SPLATS);
    gl.activeTexture(gl.TEXTURE2);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW_SPLATS, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, this.ordered);
    gl.activeTexture(gl.TEXTURE0);
  }

  /**
   * Draws. `matrices`: 3 rows of 4 for each slot, from its frame to the camera's; `camera`: size_px,
   * focal_px and center_px of the image; `rules`: sky, near_m, antialias, and 255 times the least alpha, faintest.
   */
  draw(matrices, { size_px: [width, height], focal_px: focal, center_px: middle }, { sky, near_m: near, antialias, faintest }) {
    const { gl, element, at } = this;
    if (element.width !== width || element.height !== height) Object.assign(element, { width, height });
    gl.viewport(0, 0, width, height);
    gl.activeTexture(gl.TEXTURE1);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3, matrices.length / 12, gl.RGBA, gl.FLOAT, matrices);
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform2f(at.focal, focal[0], focal[1]);
    gl.uniform2f(at.size, width, height);
    gl.uniform2f(at.middle, middle[0], middle[1]);
    // Beyond it the linear approximation of the projection fails.
    gl.uniform2f(at.limit, (0.65 * width) / focal[0], (0.65 * height) / focal[1]);
    gl.uniform1f(at.near, near);
    gl.uniform1f(at.faintest, faintest);
    gl.uniform1i(at.antialias, antialias ? 1 : 0);
    gl.clearColor(sky[0], sky[1], sky[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (this.count > 0) gl.drawArrays(gl.TRIANGLES, 0, 3 * this.count);
  }
}
