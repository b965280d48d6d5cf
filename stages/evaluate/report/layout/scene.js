// Draws the scan of the page with WebGL: an orbit around the sensor, colours by a choice, a legend of what they mean.
(async () => {
  const host = document.getElementById("scene");
  const canvas = host.querySelector("canvas"), choice = host.querySelector("select"), legend = host.querySelector(".legend");
  const fail = (why) => { host.dataset.state = "failed"; legend.textContent = why; canvas.hidden = true; };
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return fail("This browser draws no WebGL, so there is no scan to turn here.");
  if (!window.DecompressionStream) return fail("This browser is too old to unpack the scan.");

  const told = JSON.parse(document.getElementById("scene-data").textContent), n = told.points;
  const packed = Uint8Array.from(atob(told.data), (c) => c.charCodeAt(0));
  const plain = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  const places = new Float32Array(3 * n);
  let at = 0;
  for (let axis = 0; axis < 3; axis++, at += 2 * n) {
    const steps = new DataView(plain, at, 2 * n);
    for (let i = 0, sum = 0; i < n; i++) places[3 * i + axis] = (sum = (sum + steps.getInt16(2 * i, true)) << 16 >> 16) / 100;
  }

  // What colours can mean: a value between a darkest and a brightest, or a class.
  const ramp = [[70, 60, 140], [60, 100, 175], [50, 150, 165], [75, 190, 135], [165, 215, 90], [250, 232, 90]];
  const shade = (t) => {
    const x = Math.min(Math.max(t, 0), 1) * (ramp.length - 1), i = Math.min(Math.floor(x), ramp.length - 2);
    return ramp[i].map((c, k) => c + (x - i) * (ramp[i + 1][k] - c));
  };
  const heights = Float32Array.from({ length: n }, (_, i) => places[3 * i + 2]).sort();
  const low = heights[Math.floor(0.02 * n)], high = Math.max(heights[Math.floor(0.98 * (n - 1))], low + 0.01);
  const kinds = [{ name: "height", unit: "m", low, high, of: (i) => shade((places[3 * i + 2] - low) / (high - low)) }];
  for (const column of told.columns) {
    const values = new Uint8Array(plain, at, n);
    kinds.push({ ...column, of: (i) => shade(values[i] / 255) });
    at += n;
  }
  if (told.classes) {
    const values = new Uint8Array(plain, at, n), lift = (c) => 40 + 0.84 * c;  // so that none is black on black
    kinds.unshift({ name: "class", classes: told.classes, of: (i) => told.classes[values[i]][1].map(lift) });
  }

  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 place; attribute vec3 colour; uniform mat4 camera; uniform float size; varying vec3 seen;
    void main() { gl_Position = camera * vec4(place, 1.0); gl_PointSize = clamp(size / gl_Position.w, 1.0, 9.0); seen = colour; }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER,
    "precision mediump float; varying vec3 seen; void main() { gl_FragColor = vec4(seen, 1.0); }"));
  gl.linkProgram(program);
  gl.useProgram(program);
  const attribute = (name, data, type, normal) => {
    const where = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(where, 3, type, normal, 0, 0);
  };
  attribute("place", places, gl.FLOAT, false);
  const camera = gl.getUniformLocation(program, "camera"), size = gl.getUniformLocation(program, "size");
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(0.063, 0.075, 0.102, 1);

  // The eye looks at `aim` from `far` metres, from an azimuth and a height (radians).
  let azimuth = -2.4, tilt = 0.55, far = 38, aim = [4, 0, -1], waiting = false;
  const axes = () => {
    const [sa, ca, st, ct] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(tilt), Math.cos(tilt)];
    return { back: [ca * ct, sa * ct, st], right: [-sa, ca, 0], up: [-ca * st, -sa * st, ct] };
  };
  const draw = () => {
    waiting = false;
    const scale = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * scale);
    canvas.height = Math.round(canvas.clientHeight * scale);
    gl.viewport(0, 0, canvas.width, canvas.height);
    const { back, right, up } = axes(), eye = aim.map((a, k) => a + far * back[k]);
    const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    const f = 1.6, g = f * canvas.height / canvas.width, [near, end] = [0.2, 600];
    const [p, q] = [(end + near) / (near - end), 2 * end * near / (near - end)];
    const rows = [[...right.map((c) => g * c), -g * dot(right, eye)], [...up.map((c) => f * c), -f * dot(up, eye)],
      [...back.map((c) => p * c), -p * dot(back, eye) + q], [...back.map((c) => -c), dot(back, eye)]];
    gl.uniformMatrix4fv(camera, false, new Float32Array([0, 1, 2, 3].flatMap((k) => rows.map((row) => row[k]))));
    gl.uniform1f(size, 42 * scale);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArrays(gl.POINTS, 0, n);
    host.dataset.state = "drawn";
  };
  const again = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };
  const turn = (dx, dy) => { azimuth -= 0.008 * dx; tilt = Math.min(Math.max(tilt + 0.008 * dy, -0.2), 1.55); };
  const nearer = (by) => { far = Math.min(Math.max(far * by, 2), 250); };
  const move = (dx, dy) => {
    const { right, up } = axes(), step = far / canvas.clientHeight * 1.25;
    aim = aim.map((a, k) => a + step * (dy * up[k] - dx * right[k]));
  };

  const held = new Map();
  canvas.addEventListener("pointerdown", (e) => { held.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => held.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const before = held.get(e.pointerId);
    if (!before) return;
    const [dx, dy] = [e.clientX - before.clientX, e.clientY - before.clientY];
    if (held.size === 2) {
      const other = [...held.values()].find((p) => p.pointerId !== e.pointerId);
      const apart = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY) || 1;
      nearer(apart(before) / apart(e));
      move(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons & 6) move(dx, dy);
    else turn(dx, dy);
    held.set(e.pointerId, e);
    again();
  });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); nearer(Math.exp(0.0015 * e.deltaY)); again(); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const keys = { ArrowLeft: () => turn(-12, 0), ArrowRight: () => turn(12, 0), ArrowUp: () => turn(0, 12),
      ArrowDown: () => turn(0, -12), "+": () => nearer(0.85), "-": () => nearer(1.18) };
    if (keys[e.key]) { e.preventDefault(); keys[e.key](); again(); }
  });
  new ResizeObserver(again).observe(canvas);

  const css = (colour) => `rgb(${colour.map(Math.round)})`;
  const paint = () => {
    const kind = kinds[choice.value], colours = new Uint8Array(3 * n);
    for (let i = 0; i < n; i++) colours.set(kind.of(i).map(Math.round), 3 * i);
    attribute("colour", colours, gl.UNSIGNED_BYTE, true);
    const number = (x) => `${+x.toPrecision(3)}${kind.unit ? ` ${kind.unit}` : ""}`;
    const swatch = (fill) => { const box = document.createElement("i"); box.style.background = fill; return box; };
    legend.replaceChildren(...(kind.classes
      ? Object.values(kind.classes).flatMap(([name, colour]) => [swatch(css(colour.map((c) => 40 + 0.84 * c))), `${name} `])
      : [`${number(kind.low)} `, swatch(`linear-gradient(to right, ${ramp.map(css).join(",")})`), number(kind.high)]));
    legend.classList.toggle("ramp", !kind.classes);
    again();
  };
  choice.replaceChildren(...kinds.map((kind, k) => new Option(kind.name, k)));
  choice.addEventListener("change", paint);
  paint();
})();
