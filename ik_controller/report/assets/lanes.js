// One line for each thing that the arm did or that held it back, filled where it was so.
class Lanes {
  constructor(host, onHover) {
    const order = run.lanes.map((lane, number) => [lane, number]) // what it did, then what held it back, the longest first
      .sort(([a], [b]) => a.held - b.held || b.seconds - a.seconds);
    this.lanes = order.map(([lane, number]) => {
      const row = element("div", host, null, lane.held ? "lane held" : "lane");
      element("span", row, lane.name, "label");
      const bar = element("span", row, null, "bar"), canvas = element("canvas", bar), at = element("i", bar, null, "at");
      const worst = lane.scale < 0.995 && lane.held ? `, down to ${Math.round(100 * lane.scale)} %` : "";
      element("span", row, `${lane.seconds.toFixed(2)} s, ${lane.share < 0.01 ? "< 1" : Math.round(100 * lane.share)} %${worst}`, "share");
      const hover = (e) => {
        const box = canvas.getBoundingClientRect();
        onHover(this.min + (this.max - this.min) * (e.clientX - box.left) / box.width);
      };
      canvas.addEventListener("pointermove", hover);
      canvas.addEventListener("pointerdown", hover);
      return { number, held: lane.held, canvas, at };
    });
    this.zoom(0, run.duration);
  }

  zoom(min, max) { this.min = min; this.max = max; this.draw(); }

  draw() {
    const ratio = Math.max(window.devicePixelRatio || 1, 1);
    for (const { number, held, canvas } of this.lanes) {
      const c = canvas.getContext("2d"), width = canvas.clientWidth || 300;
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(16 * ratio);
      c.fillStyle = colour(held ? "--bad" : "--tool");
      const x = (t) => canvas.width * (t - this.min) / (this.max - this.min);
      run.masks.forEach(([first, ...bits], i) => {
        if (!bits.includes(number)) return;
        const end = i + 1 < run.masks.length ? time[run.masks[i + 1][0]] : run.duration;
        const [a, b] = [x(time[first]), x(end)];
        if (b >= 0 && a <= canvas.width) c.fillRect(a, 0, Math.max(b - a, ratio), canvas.height); // a pixel at least
      });
    }
    this.show(this.bucket || 0);
  }

  show(k) {
    this.bucket = k;
    const share = (time[k] - this.min) / (this.max - this.min);
    for (const { at } of this.lanes) {
      at.style.display = share >= 0 && share <= 1 ? "" : "none";
      at.style.left = `${100 * share}%`;
    }
  }
}
