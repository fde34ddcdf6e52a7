// Plots over time by uPlot. Where a bucket is more than one cycle a curve is a band between smallest and largest.
const HEIGHT = 196;

class Chart {
  constructor(spec, parent, onHover, onZoom) {
    this.spec = spec;
    this.series = spec.series.filter((s) => columns[s.column]);
    this.shown = this.series.map((s, i) => !spec.log || i === 0);
    this.largest = Math.max(...this.series.map((s) => extent(columns[s.column])));
    this.relative = this.series.every((s) => s.half > 0); // of limits
    this.log = Boolean(spec.log) && spread(columns[this.series[0].column].high) > 50;
    this.onHover = onHover; this.onZoom = onZoom;
    this.box = element("div", parent, null, "chart");
    this.box.id = `chart-${spec.id}`;
    const head = element("div", this.box, null, "head");
    element("h2", head, spec.title);
    element("span", head, spec.note, "note");
    if (spec.log) this.button(head, () => (this.log ? "linear" : "logarithmic"), () => { this.log = !this.log; });
    if (this.relative) this.button(head, () => (this.relative ? `in ${this.series[0].unit}` : "in % of limit"), () => { this.relative = !this.relative; });
    this.legend = element("div", this.box, null, spec.log ? "legend few" : run.bucket > 1 ? "legend spans" : "legend");
    this.numbers = this.series.map((s, i) => {
      const button = element("button", this.legend, s.label);
      button.type = "button";
      button.style.setProperty("--color", `var(--c${i % 8})`);
      button.classList.toggle("off", !this.shown[i]);
      button.addEventListener("click", () => {
        this.shown[i] = !this.shown[i];
        button.classList.toggle("off", !this.shown[i]);
        this.make();
      });
      return element("span", button, "", "number");
    });
    this.host = element("div", this.box, null, "plot");
    this.host.style.minHeight = `${HEIGHT}px`; // the page keeps its length while plots come
    this.range = null;
  }

  button(head, name, act) {
    const made = element("button", head, name());
    made.type = "button";
    made.addEventListener("click", () => { act(); made.textContent = name(); this.make(); });
  }

  // [factor, offset] that brings a series into the axis' unit
  axisUnit() {
    const { spec } = this;
    if (spec.percent) return [0.01, "%"];
    if (this.relative && this.series[0].half > 0) return [null, "% of limit"];
    const unit = spec.unit ?? this.series[0].unit;
    return prefixed(this.largest, unit);
  }

  make() {
    const { spec } = this, [factor, unit] = this.axisUnit(), banded = run.bucket > 1;
    this.factor = factor; this.unit = unit;
    const data = [time], series = [{}];
    this.series.forEach((s, i) => {
      const { low, high } = columns[s.column];
      const [slope, from] = factor == null ? [100 / s.half, s.center] : [1 / factor, 0];
      const [a, b] = this.log ? [lengths(low, high, slope, Math.min), banded ? lengths(low, high, slope, Math.max) : null]
        : [plain(low, slope, from), banded ? plain(high, slope, from) : null];
      const ink = () => colour(`--c${i % 8}`), style = { show: this.shown[i], points: { show: false }, spanGaps: false };
      if (banded) { // the lows are only there for the scale
        data.push(b, a); series.push({ ...style, stroke: ink, fill: ink, width: 1, paths: band }, { ...style, paths: () => null });
      } else { data.push(a); series.push({ ...style, stroke: ink, width: 1.4 }); }
    });
    this.guides = (spec.guides || []).map((g) => ({ value: g.value / (factor || 1), label: g.label }));
    if (factor == null) this.guides = [{ value: 100, label: "limit" }, { value: -100, label: "" }];
    const axis = { stroke: () => colour("--soft"), grid: { stroke: () => colour("--grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const options = {
      width: Math.max(this.host.clientWidth, 200), height: this.height || HEIGHT, padding: [8, 12, 0, 0],
      legend: { show: false },
      cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false } },
      series,
      scales: { x: { time: false }, y: this.scale(data) },
      axes: [
        { ...axis, size: 26, gap: 2, values: (u, ticks) => ticks.map((t, i) => (i === ticks.length - 1 ? `${+t.toFixed(4)} s` : +t.toFixed(4))) },
        { ...axis, size: 58, gap: 4, label: unit || undefined, labelSize: unit ? 16 : 0, labelGap: 0, labelFont: "11px system-ui, sans-serif",
          values: (u, ticks) => ticks.map((v) => (v == null ? "" : this.log ? power(v) : +v.toPrecision(6))) },
      ],
      hooks: {
        draw: [(u) => this.drawGuides(u)],
        setCursor: [(u) => { if (u.cursor.left >= 0 && u.cursor.event) this.onHover(u.posToVal(u.cursor.left, "x")); }],
        setScale: [(u, key) => { if (key === "x" && this.ready) this.onZoom(this, u.scales.x.min, u.scales.x.max); }],
      },
    };
    this.ready = false;
    if (this.plot) this.plot.destroy();
    this.plot = new uPlot(options, data, this.host);
    this.line = element("div", this.plot.over, null, "now-line");
    if (this.range) this.plot.setScale("x", this.range);
    this.show(this.bucket || 0);
    queueMicrotask(() => { this.ready = true; this.show(this.bucket || 0); });
  }

  scale(data) {
    if (this.log) {
      const values = data.slice(1).filter((_, i) => this.shown[run.bucket > 1 ? i >> 1 : i]).flatMap(sample).filter((v) => v > 0).sort((a, b) => a - b);
      const high = values.length ? values[values.length - 1] : 1;
      const low = values.length ? Math.max(values[Math.floor(0.03 * values.length)], high * 1e-9) : 0.1;
      return { distr: 3, range: () => [10 ** Math.floor(Math.log10(low)), 10 ** Math.ceil(Math.log10(high * 1.01))] };
    }
    if (this.factor == null) return { range: (u, low, high) => [Math.min(-108, low - 4), Math.max(108, high + 4)] };
    const guides = this.guides.map((g) => g.value);
    return { range: (u, low, high) => {
      if (low == null) return [0, 1];
      let [a, b] = [Math.min(low, ...(this.spec.guides ? guides : [])), Math.max(high, ...(this.spec.guides ? guides : []))];
      if (this.spec.top != null) b = Math.max(b, this.spec.top / this.factor);
      if (a > 0 && a < 0.7 * b) a = 0;
      const pad = 0.06 * (b - a || Math.abs(b) || 1);
      return [a === 0 ? 0 : a - pad, b + pad];
    } };
  }

  drawGuides(u) {
    const c = u.ctx, { left, top, width, height } = u.bbox, ratio = devicePixelRatio || 1;
    c.save();
    c.strokeStyle = c.fillStyle = colour("--guide"); c.lineWidth = ratio; c.setLineDash([5 * ratio, 4 * ratio]);
    c.font = `${11 * ratio}px system-ui, sans-serif`; c.textAlign = "right"; c.textBaseline = "alphabetic";
    for (const guide of this.guides) {
      const y = u.valToPos(guide.value, "y", true);
      if (!(y >= top && y <= top + height)) continue;
      c.beginPath(); c.moveTo(left, y); c.lineTo(left + width, y); c.stroke();
      if (guide.label) c.fillText(guide.label, left + width - 4 * ratio, y + (y - top > 16 * ratio ? -4 : 13) * ratio);
    }
    c.restore();
  }

  // Move the cursor to a bucket, and tell its numbers.
  show(k) {
    this.bucket = k;
    if (!this.plot) return;
    const x = this.plot.valToPos(time[k], "x");
    this.line.style.display = x >= 0 && x <= this.plot.over.clientWidth ? "" : "none";
    this.line.style.transform = `translateX(${x.toFixed(1)}px)`;
    this.series.forEach((s, i) => {
      const { low, high } = columns[s.column], scaled = this.factor || 1;
      const unit = this.factor == null ? s.unit : (this.spec.unit ?? s.unit);
      this.numbers[i].textContent = this.spec.percent ? `${short(low[k] / scaled)} %` : span(low[k], high[k], unit || "");
    });
  }

  zoom(min, max) {
    this.range = { min, max };
    if (!this.plot) return;
    this.ready = false;
    this.plot.setScale("x", this.range);
    queueMicrotask(() => { this.ready = true; this.show(this.bucket); });
  }

  resize(width, height) {
    this.height = height || HEIGHT;
    if (!this.plot) return;
    this.plot.setSize({ width: width || Math.max(this.host.clientWidth, 200), height: this.height });
    queueMicrotask(() => this.show(this.bucket));
  }

  redraw() { this.plot?.redraw(false, true); }
}

// The path of a band between the highs of series i and the lows behind them: one outline, a point a pixel at most. It is
// never thinner than a line.
function band(u, i, first, last) {
  const [times, highs, lows] = [u.data[0], u.data[i], u.data[i + 1]], path = new Path2D(), thin = 0.6 * uPlot.pxRatio;
  let points = [];
  const close = () => {
    points.forEach(([x, top], k) => (k ? path.lineTo(x, top) : path.moveTo(x, top)));
    for (let k = points.length - 1; k >= 0; k--) path.lineTo(points[k][0], points[k][2]);
    if (points.length) path.closePath();
    points = [];
  };
  for (let k = first; k <= last; k++) {
    if (highs[k] == null || lows[k] == null) { close(); continue; }
    const x = Math.round(u.valToPos(times[k], "x", true)), before = points[points.length - 1];
    let [top, bottom] = [u.valToPos(highs[k], "y", true) - thin, u.valToPos(lows[k], "y", true) + thin];
    if (before?.[0] === x) {
      before[1] = Math.min(before[1], top); before[2] = Math.max(before[2], bottom);
      continue;
    }
    if (before && x - before[0] < 2) { // steep: from pixel to pixel without a break
      top = Math.min(top, before[2]); bottom = Math.max(bottom, before[1]);
    }
    points.push([x, top, bottom]);
  }
  close();
  const sparse = (last - first) * uPlot.pxRatio < 0.5 * u.bbox.width;
  return { stroke: sparse ? path : null, fill: path };
}

// A column for uPlot: slope · (value - from), gaps are null.
function plain(column, slope, from) {
  const made = new Float64Array(column.length);
  let gaps = false;
  for (let k = 0; k < column.length; k++) gaps = Number.isNaN(made[k] = slope * (column[k] - from)) || gaps;
  return gaps ? Array.from(made, (v) => (Number.isNaN(v) ? null : v)) : made;
}

// The same of lengths, for a logarithmic axis; nothing is a gap there.
function lengths(low, high, slope, pick) {
  const made = new Float64Array(low.length);
  let gaps = false;
  for (let k = 0; k < low.length; k++) gaps = !((made[k] = slope * pick(Math.abs(low[k]), Math.abs(high[k]))) > 0) || gaps;
  return gaps ? Array.from(made, (v) => (v > 0 ? v : null)) : made;
}

function sample(column) {
  const every = Math.max(1, Math.floor(column.length / 2000)), found = [];
  for (let k = 0; k < column.length; k += every) if (column[k] != null) found.push(column[k]);
  found.push(column.reduce((most, v) => (v > most ? v : most), 0));
  return found;
}

function extent({ low, high }) {
  let most = 0;
  for (let k = 0; k < low.length; k++) {
    if (-low[k] > most) most = -low[k];
    if (high[k] > most) most = high[k];
  }
  return most;
}

// How far the largest stands out of the middle.
function spread(values) {
  const sorted = values.filter((v) => v > 0).sort(); // a typed array sorts by number
  return sorted.length ? sorted[sorted.length - 1] / sorted[sorted.length >> 1] : 1;
}

function power(value) {
  const exponent = Math.log10(value);
  if (Math.abs(exponent - Math.round(exponent)) > 1e-6) return "";
  const n = Math.round(exponent);
  return n >= -3 && n <= 4 ? String(10 ** n) : `10${String(n).replace(/./g, (d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d] ?? "⁻")}`;
}
