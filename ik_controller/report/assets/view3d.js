// The arm and the paths on a plain canvas: orthographic, turned by dragging, far things drawn first.
class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.paths = ["target", "tool"].map((what) => this.path(what));
    this.bucket = 0;
    this.home();
    new ResizeObserver(() => this.draw()).observe(canvas);
    const drag = { on: false };
    canvas.addEventListener("pointerdown", (e) => { drag.on = true; [drag.x, drag.y] = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointerup", () => { drag.on = false; });
    canvas.addEventListener("pointermove", (e) => {
      if (!drag.on) return;
      this.turn(-(e.clientX - drag.x) * 0.008, (e.clientY - drag.y) * 0.008);
      [drag.x, drag.y] = [e.clientX, e.clientY];
    });
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY * 0.0015)); }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.home(); this.draw(); });
    canvas.addEventListener("keydown", (e) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
      if (step) { e.preventDefault(); this.turn(...step); }
    });
  }

  home() {
    this.yaw = -0.95; this.pitch = 0.42;
    // What must be seen: the paths, and the arm where it began and half way.
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const see = (p, r) => p.forEach((v, i) => { low[i] = Math.min(low[i], v - r); high[i] = Math.max(high[i], v + r); });
    for (const path of this.paths) for (const p of path) if (p) see(p, 0.02);
    const k = [...Array(run.rows).keys()].find((i) => jointsAt(i)) ?? -1;
    if (k >= 0) for (const frame of framesAt(jointsAt(k))) see(frame.slice(9), 0.07);
    if (!Number.isFinite(low[0])) { low.fill(-0.5); high.fill(0.5); }
    this.centre = low.map((v, i) => 0.5 * (v + high[i]));
    this.extent = Math.hypot(...low.map((v, i) => high[i] - v));
    // The room that it takes on the screen, as seen at first; turning does not change the scale.
    this.orient();
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => this.direct(low.map((v, i) => (k >> i & 1 ? high[i] : v) - this.centre[i])));
    [this.across, this.upright] = [0, 1].map((i) => 2 * Math.max(...corners.map((p) => Math.abs(p[i]))));
    this.floor = Math.min(0, low[2]);
    this.factor = 1;
  }

  // Points of a path, thinned out to what an eye can tell apart; null where there is none.
  path(what) {
    const parts = ["x", "y", "z"].map((axis) => columns[`${what}_${axis}_m`]?.first);
    if (!parts[0]) return [];
    const every = Math.max(1, Math.floor(run.rows / 4000)), points = [];
    for (let k = 0; k < run.rows; k += every) {
      const p = parts.map((part) => part[k]);
      points.push(p.every(Number.isFinite) ? p : null);
    }
    return points;
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, -1.57), 1.57);
    this.draw();
  }

  zoom(factor) { this.factor = Math.min(Math.max(this.factor * factor, 0.3), 20); this.draw(); }

  show(bucket) { this.bucket = bucket; this.draw(); }

  orient() {
    [this.cosYaw, this.sinYaw] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    [this.cosPitch, this.sinPitch] = [Math.cos(this.pitch), Math.sin(this.pitch)];
  }

  // x to the right, y down [pixels], depth towards the eye [m]
  project(p) {
    const [x, y, z] = [p[0] - this.centre[0], p[1] - this.centre[1], p[2] - this.centre[2]];
    const along = this.cosYaw * x + this.sinYaw * y, away = -this.sinYaw * x + this.cosYaw * y;
    const up = this.cosPitch * z + this.sinPitch * away;
    return [this.width / 2 + this.scale * along, this.height / 2 - this.scale * up, this.sinPitch * z - this.cosPitch * away];
  }

  // A direction on the screen, the third towards the eye.
  direct(v) {
    const along = this.cosYaw * v[0] + this.sinYaw * v[1], away = -this.sinYaw * v[0] + this.cosYaw * v[1];
    return [along, -(this.cosPitch * v[2] + this.sinPitch * away), this.sinPitch * v[2] - this.cosPitch * away];
  }

  draw() {
    const { canvas, context: c } = this, ratio = Math.max(window.devicePixelRatio || 1, 1);
    this.width = canvas.clientWidth; this.height = canvas.clientHeight;
    if (!this.width || !this.height) return;
    canvas.width = Math.round(this.width * ratio); canvas.height = Math.round(this.height * ratio);
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.width, this.height);
    c.lineJoin = c.lineCap = "round";
    this.orient();
    this.scale = this.factor * Math.min((this.width - 30) / this.across, (this.height - 24) / this.upright);
    this.drawFloor();
    const q = jointsAt(this.bucket), frames = q && framesAt(q);
    if (frames) this.drawArm(frames);
    this.drawPath(this.paths[0], colour("--target"), 5, 0.5);
    this.drawPath(this.paths[1], colour("--tool"), 1.6, 1);
    if (frames) this.drawFrame(frames[frames.length - 1], 0.09, 2.2);
    this.drawFrame(HERE, 0.16, 1.6, "xyz");
    const target = ["x", "y", "z"].map((axis) => columns[`target_${axis}_m`]?.first[this.bucket]);
    if (target.every(Number.isFinite)) {
      const [x, y] = this.project(target);
      c.strokeStyle = colour("--target"); c.lineWidth = 2.5;
      c.beginPath(); c.arc(x, y, 8, 0, 2 * Math.PI); c.stroke();
    }
  }

  drawFloor() {
    const c = this.context, cell = this.extent > 4 ? 0.5 : this.extent > 1.2 ? 0.2 : 0.1;
    const n = Math.ceil(0.55 * this.extent / cell), x0 = Math.round(this.centre[0] / cell), y0 = Math.round(this.centre[1] / cell);
    c.strokeStyle = colour("--line"); c.lineWidth = 1;
    c.beginPath();
    for (let i = -n; i <= n; i++) {
      for (const [a, b] of [[[x0 + i, y0 - n], [x0 + i, y0 + n]], [[x0 - n, y0 + i], [x0 + n, y0 + i]]]) {
        c.moveTo(...this.project([a[0] * cell, a[1] * cell, this.floor]).slice(0, 2));
        c.lineTo(...this.project([b[0] * cell, b[1] * cell, this.floor]).slice(0, 2));
      }
    }
    c.stroke();
    c.fillStyle = colour("--soft"); c.font = "12px system-ui, sans-serif";
    c.fillText(`grid ${cell} m`, 14, this.height - 12);
  }

  drawPath(points, stroke, width, alpha) {
    const c = this.context;
    c.strokeStyle = stroke; c.lineWidth = width; c.globalAlpha = alpha;
    c.beginPath();
    let pen = false;
    for (const point of points) {
      if (!point) { pen = false; continue; }
      const [x, y] = this.project(point);
      if (pen) c.lineTo(x, y); else c.moveTo(x, y);
      pen = true;
    }
    c.stroke();
    c.globalAlpha = 1;
  }

  drawFrame(frame, length, width, names = "") {
    const c = this.context, origin = [frame[9], frame[10], frame[11]];
    ["#e03131", "#2f9e44", "#3b76e1"].forEach((stroke, i) => {
      const tip = [0, 1, 2].map((j) => origin[j] + length * frame[3 * j + i]);
      const [a, b] = [this.project(origin), this.project(tip)];
      c.strokeStyle = c.fillStyle = stroke; c.lineWidth = width;
      c.beginPath(); c.moveTo(a[0], a[1]); c.lineTo(b[0], b[1]); c.stroke();
      if (names) { c.font = "600 12px system-ui, sans-serif"; c.fillText(names[i], b[0] + 4, b[1] + 4); }
    });
  }

  drawArm(frames) {
    const c = this.context, pieces = [];
    for (const solid of run.arm.solids) {
      const at = times(frames[solid.joint], solid.placement);
      pieces.push([this.project(at.slice(9))[2], solid, at]);
    }
    pieces.sort((a, b) => a[0] - b[0]);
    c.globalAlpha = 0.9;
    for (const [, solid, at] of pieces) this[solid.shape](solid.size, at, solid.color);
    c.globalAlpha = 1;
    // The skeleton: from joint to joint, to the tool.
    const points = frames.map((frame) => this.project(frame.slice(9)));
    const plain = !run.arm.solids.length;
    // Dark below light, so that it is seen on the arm and beside it.
    for (const [stroke, width] of plain ? [[colour("--soft"), 7]] : [["rgba(16,22,32,.8)", 4], ["#ffffff", 1.6]]) {
      c.strokeStyle = stroke; c.lineWidth = width;
      c.beginPath();
      points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
      c.stroke();
    }
    for (const [x, y] of points.slice(1, -1)) {
      c.beginPath(); c.arc(x, y, plain ? 5 : 3, 0, 2 * Math.PI);
      c.fillStyle = "#ffffff"; c.fill();
      c.lineWidth = 1.6; c.strokeStyle = "rgba(16,22,32,.9)"; c.stroke();
    }
  }

  sphere([radius], at, fill) {
    const c = this.context, [x, y] = this.project(at.slice(9)), r = radius * this.scale;
    const shade = c.createRadialGradient(x - 0.35 * r, y - 0.4 * r, 0.05 * r, x, y, r);
    shade.addColorStop(0, mix(fill, 255, 0.35)); shade.addColorStop(1, mix(fill, 0, 0.22));
    c.fillStyle = shade;
    c.beginPath(); c.arc(x, y, r, 0, 2 * Math.PI); c.fill();
  }

  cylinder([radius, length], at, fill) {
    const c = this.context, axis = this.direct([at[2], at[5], at[8]]), r = radius * this.scale;
    const [x, y] = this.project(at.slice(9)), half = 0.5 * length * this.scale;
    const across = Math.hypot(axis[0], axis[1]), angle = Math.atan2(axis[1], axis[0]), flat = Math.abs(axis[2]) * r;
    const near = axis[2] >= 0 ? 1 : -1;
    c.save();
    c.translate(x, y); c.rotate(angle); // its axis lies along x now
    const end = half * across, shade = c.createLinearGradient(0, -r, 0, r);
    const flip = Math.cos(angle) < 0; // the light comes from above
    [[0, 0.18, 255], [0.3, 0.42, 255], [1, 0.3, 0]].forEach(([s, share, to]) => shade.addColorStop(flip ? 1 - s : s, mix(fill, to, share)));
    c.fillStyle = shade;
    c.beginPath();
    c.ellipse(end, 0, flat, r, 0, -Math.PI / 2, Math.PI / 2);
    c.ellipse(-end, 0, flat, r, 0, Math.PI / 2, 1.5 * Math.PI);
    c.closePath(); c.fill();
    c.fillStyle = mix(fill, 255, 0.12);
    c.beginPath(); c.ellipse(near * end, 0, flat, r, 0, 0, 2 * Math.PI); c.fill();
    c.restore();
  }

  box(size, at, fill) {
    const c = this.context;
    for (let i = 0; i < 3; i++) {
      for (const side of [-1, 1]) {
        const normal = [0, 1, 2].map((j) => side * at[3 * j + i]), seen = this.direct(normal);
        if (seen[2] <= 0) continue;
        const [u, v] = [(i + 1) % 3, (i + 2) % 3];
        c.beginPath();
        [[-1, -1], [1, -1], [1, 1], [-1, 1]].forEach(([a, b], k) => {
          const local = [0, 0, 0];
          local[i] = 0.5 * side * size[i]; local[u] = 0.5 * a * size[u]; local[v] = 0.5 * b * size[v];
          const p = this.project([0, 1, 2].map((j) => at[9 + j] + at[3 * j] * local[0] + at[3 * j + 1] * local[1] + at[3 * j + 2] * local[2]));
          if (k) c.lineTo(p[0], p[1]); else c.moveTo(p[0], p[1]);
        });
        c.closePath();
        c.fillStyle = seen[1] < 0 ? mix(fill, 255, 0.3 * -seen[1]) : mix(fill, 0, 0.28 * seen[1] + 0.05);
        c.fill();
      }
    }
  }
}

// A colour "#rrggbb" on its way to black (0) or white (255).
function mix(from, to, share) {
  const parts = [1, 3, 5].map((i) => parseInt(from.slice(i, i + 2), 16));
  return `rgb(${parts.map((v) => Math.round(v + share * (to - v))).join(",")})`;
}
