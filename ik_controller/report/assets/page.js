// The page: words, then views that share one time and one range.
const page = (() => {
  const get = (id) => document.getElementById(id), root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const setTheme = (name) => { root.dataset.theme = name; };
  setTheme(dark.matches ? "dark" : "light");

  // Words
  get("bag").textContent = [run.bag, run.robot, run.when].filter(Boolean).join(" · ");
  get("headline").textContent = run.headline;
  for (const fact of run.facts) {
    const box = element("div", get("facts"), null, fact.good == null ? "fact" : fact.good ? "fact good" : "fact bad");
    element("div", box, fact.name, "name");
    element("div", box, fact.value, fact.value.length > 18 ? "value words" : "value");
    element("div", box, fact.text.replace(/(\d) (?=[a-zµ%])/g, "$1\u00a0"), "text"); // a number keeps its unit
  }
  for (const [at, text] of run.events) element("li", get("events"), `${at.toFixed(2)} s  ${text}`);
  if (run.rejected) element("li", get("events"), `${run.rejected} messages were rejected, the last: ${run.last_rejected}`);
  get("sampling").textContent = run.bucket > 1
    ? `${run.cycles} cycles, drawn in ${run.rows} columns of ${run.bucket} cycles (${short(1e3 * run.bucket * run.dt)} ms). Each column shows the smallest and the largest value in it, so no peak is lost; path and arm show its first cycle. For every number: ik_controller report BAG --csv FILE.`
    : `${run.cycles} cycles, every one of them drawn.`;
  for (const { title, header, rows } of run.tables) {
    const long = rows.length > 24, box = element("details", get("tables"), null, long ? "table long" : "table");
    box.open = !long;
    element("summary", box, title);
    const table = element("table", element("div", box, null, "rows"));
    if (header.some(Boolean)) header.forEach((text) => element("th", table.tHead?.rows[0] || table.createTHead().insertRow(), text));
    for (const row of rows) {
      const line = element("tr", table);
      row.forEach((text, i) => breakable(element("td", line, text, i === 0 && text.length > 40 ? "wide" : /^-?[\d.]+$/.test(text) ? "count" : "")));
      if (header[2] === "at this replay" && row[2] && row[2] !== "the same") line.className = "changed";
    }
  }

  // Views
  let now = 0;
  const scene = new Scene(get("scene")), lanes = new Lanes(get("lanes"), (t) => show(bucketAt(t))), charts = [];
  const zoom = (from, min, max) => {
    get("whole").hidden = max - min > 0.999 * (time[time.length - 1] - time[0]);
    for (const chart of charts) if (chart !== from) chart.zoom(min, max);
    if (from) from.range = { min, max };
    lanes.zoom(min, max);
    if (from) from.show(now);
  };
  for (const spec of run.charts) {
    const host = ["position_error", "orientation_error"].includes(spec.id) ? get("errors") : get("plots");
    charts.push(new Chart(spec, host, (t) => show(bucketAt(t)), zoom));
  }
  if (!get("errors").children.length) get("top").style.gridTemplateColumns = "minmax(0, 1fr)";

  function show(k) {
    now = Math.min(Math.max(k, 0), run.rows - 1);
    get("slider").value = now;
    get("now").textContent = `${time[now].toFixed(run.duration < 100 ? 3 : 2)} s`;
    get("state").textContent = lanesAt(now).map((lane) => run.lanes[lane].name).join("; ");
    scene.show(now);
    lanes.show(now);
    for (const chart of charts) chart.show(now);
  }

  const slider = get("slider");
  slider.max = run.rows - 1;
  slider.addEventListener("input", () => show(Number(slider.value)));
  get("whole").addEventListener("click", () => zoom(null, time[0], time[time.length - 1]));

  let playing = null;
  const play = (on) => {
    if (playing) cancelAnimationFrame(playing);
    playing = null;
    get("play").textContent = on ? "❚❚" : "▶";
    if (!on) return;
    if (now >= run.rows - 1) show(0);
    const began = performance.now(), from = time[now];
    const tick = () => {
      const t = from + (performance.now() - began) * 1e-3; // real time
      show(bucketAt(t));
      if (t >= time[run.rows - 1]) play(false); else playing = requestAnimationFrame(tick);
    };
    playing = requestAnimationFrame(tick);
  };
  get("play").addEventListener("click", () => play(!playing));

  // Sizes and colours
  const redraw = () => { scene.draw(); lanes.draw(); for (const chart of charts) chart.redraw(); };
  const fit = () => { for (const chart of charts) chart.resize(); scene.draw(); lanes.draw(); };
  let fitting = null;
  addEventListener("resize", () => { clearTimeout(fitting); fitting = setTimeout(fit, 80); });
  get("theme").addEventListener("click", () => { setTheme(root.dataset.theme === "dark" ? "light" : "dark"); redraw(); });
  dark.addEventListener("change", () => { setTheme(dark.matches ? "dark" : "light"); redraw(); });
  let before = null;
  addEventListener("beforeprint", () => {
    while (waiting.length) makeNext();
    // on paper: light, two plots beside each other, tables open
    before = { theme: root.dataset.theme, open: [...document.querySelectorAll("details")].map((d) => d.open) };
    setTheme("light");
    document.querySelectorAll("details").forEach((d) => { d.open = true; });
    for (const chart of charts) chart.resize(322, 128);
    redraw();
  });
  addEventListener("afterprint", () => {
    if (!before) return;
    setTheme(before.theme);
    document.querySelectorAll("details").forEach((d, i) => { d.open = before.open[i]; });
    before = null;
    fit();
    redraw();
  });

  // Plots are made one by one, each in a task of its own: what is in sight first, so that the page is there at once.
  const sight = (chart) => { const { top, bottom } = chart.box.getBoundingClientRect(); return bottom < 0 ? -bottom : Math.max(top - innerHeight, 0); };
  const waiting = [...charts];
  const makeNext = () => {
    waiting.sort((a, b) => sight(a) - sight(b));
    waiting.shift().make();
  };
  const makeRest = () => {
    if (!waiting.length) return;
    makeNext();
    setTimeout(makeRest);
  };
  while (waiting.some((chart) => sight(chart) === 0)) makeNext();
  fit();
  show(Math.floor(0.35 * run.rows));
  requestAnimationFrame(() => setTimeout(makeRest));
  return { show, charts, scene, lanes, get now() { return now; }, get ready() { return !waiting.length; } };
})();
