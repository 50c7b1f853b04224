// Live numbers, plot and questions of a job. Without it the pages work all the same; they then have to be loaded again.
"use strict";

const SHOWN_S = 10;
const QUANTITIES = {
  force_n: "Force", motor_current_a: "Motor current", displacement_mm: "Displacement",
  battery_voltage_v: "Battery voltage", battery_current_a: "Battery current",
};
const byId = (id) => document.getElementById(id);

function follow(address, on) {
  const source = new EventSource(address);
  source.addEventListener("live", (event) => on.live(JSON.parse(event.data)));
  source.addEventListener("log", (event) => on.log(JSON.parse(event.data)));
  source.addEventListener("state", (event) => {
    const state = JSON.parse(event.data);
    if (!state.is_running) source.close();
    on.state(state);
  });
}

// What the page says of the job, made again by the server.
async function refreshStep(isFocused) {
  const answer = await fetch(location.href, { headers: { "X-Requested-With": "panel" } });
  if (!answer.ok) return;
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  byId("step").replaceWith(page.getElementById("step"));
  watch();
  const first = document.querySelector("#step [data-focus]");
  if (first && isFocused) { first.focus(); if (first.select) first.select(); }
}

function watchJob(live) {
  const plot = byId("plot") ? new LivePlot(byId("plot")) : null;
  const log = byId("log");
  let shown = document.querySelector("#step [name=number]")?.value;
  let isFirstLog = true;
  follow(live.dataset.stream, {
    live(lines) {
      for (const line of lines) showLine(line, live, plot);
      if (plot) plot.draw();
    },
    log(text) {
      log.textContent = isFirstLog ? text : log.textContent + text;
      isFirstLog = false;
      log.scrollTop = log.scrollHeight;
    },
    state(state) {
      if (!state.is_running) { location.reload(); return; }
      const number = state.question === null ? undefined : String(state.question);
      if (number !== shown) {
        shown = number;
        refreshStep(document.activeElement === document.body || !document.activeElement.matches("#note"));
      }
    },
  });
}

function showLine(line, live, plot) {
  if (line.kind === "progress") { showProgress(line, live); return; }
  live.hidden = false;
  if (line.kind === "phase") { byId("phase").textContent = line.phase; byId("clock").textContent = ""; return; }
  byId("phase").textContent = line.phase === "finishing" ? "finishing …" : line.phase;
  byId("clock").textContent = `${line.elapsed_s.toFixed(1)}${line.seconds ? ` of ${line.seconds}` : ""} s`;
  const light = byId("light");
  light.className = `light ${line.light}`;
  light.textContent = line.light.toUpperCase();
  const warnings = [...line.lost.map((name) => `${name}: the link is lost`), ...line.warnings];
  const list = byId("warnings");
  if (list.dataset.said !== warnings.join("\n")) {
    list.dataset.said = warnings.join("\n");
    list.replaceChildren(...warnings.map((text) => element("li", text)));
  }
  byId("estimate").textContent = line.estimate;
  if (plot) plot.add(line);
  showTiles(line.channels, plot);
}

function showProgress(line, place) {
  const bar = place.querySelector("progress");
  if (bar && line.total) bar.value = line.done / line.total;
  place.querySelector(".phase").textContent = line.what || "computing …";
}

function element(name, text) {
  const made = document.createElement(name);
  made.textContent = text;
  return made;
}

function showTiles(channels, plot) {
  const tiles = byId("tiles");
  if (tiles.children.length !== channels.length) {
    tiles.replaceChildren(...channels.map((channel) => {
      const tile = document.createElement("div"), value = document.createElement("dd");
      value.append(document.createElement("b"), " ", element("small", channel.unit), document.createElement("span"));
      tile.append(element("dt", QUANTITIES[channel.channel] || channel.channel), value);
      return tile;
    }));
  }
  channels.forEach((channel, number) => {
    const tile = tiles.children[number], peak = plot ? plot.peak(channel.channel) : null;
    tile.classList.toggle("warn", channel.n_missing > 0);
    tile.querySelector("dt").textContent = (QUANTITIES[channel.channel] || channel.channel) + (peak === null ? "" : ", peak of 1 s");
    tile.querySelector("b").textContent = peak !== null ? peak.toFixed(1) : channel.latest === null ? "–" : channel.latest.toFixed(1);
    tile.querySelector("span").textContent = `${Math.round(channel.rate_hz)} Hz, ${channel.n_missing} missing`;
  });
}

class LivePlot {
  constructor(place) {
    this.place = place;
    this.series = { force_n: [[], []], motor_current_a: [[], []] };
    this.elapsed = 0;
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: color("--ink"), grid: { stroke: color("--soft"), width: 1 }, ticks: { stroke: color("--soft") } };
    const line = (label, unit, scale, stroke) =>
      ({ label: `${label} / ${unit}`, scale, stroke, width: 1.5, spanGaps: true, points: { show: false } });
    this.plot = new uPlot({
      width: place.clientWidth || 600, height: 288, cursor: { drag: { x: false, y: false } }, legend: { live: false },
      scales: { x: { time: false }, N: {}, A: {} },
      series: [{ label: "Time / s" }, line("Force", "N", "N", color("--force")), line("Motor current", "A", "A", color("--current"))],
      axes: [
        { ...axis, label: "Time / s" }, { ...axis, scale: "N", label: "Force / N", stroke: color("--force") },
        { ...axis, scale: "A", side: 1, label: "Motor current / A", stroke: color("--current"), grid: { show: false } },
      ],
    }, [[], [], []], place);
    new ResizeObserver(() => this.plot.setSize({ width: place.clientWidth, height: 288 })).observe(place);
  }

  add(line) {
    if (line.elapsed_s < this.elapsed - 1) this.series = { force_n: [[], []], motor_current_a: [[], []] };
    this.elapsed = line.elapsed_s;
    for (const [name, [times, values]] of Object.entries(line.plot)) {
      const kept = this.series[name];
      if (!kept) continue;
      const from = this.elapsed - SHOWN_S;
      const first = Math.max(0, kept[0].findIndex((time) => time >= from));
      this.series[name] = [kept[0].slice(first).concat(times), kept[1].slice(first).concat(values)];
    }
  }

  // What swings with every stroke is told by its largest value of the last second; null where nothing of it came.
  peak(name) {
    const [times, values] = this.series[name] || [[], []];
    const recent = values.filter((_, number) => times[number] > times[times.length - 1] - 1);
    return recent.length ? Math.max(...recent) : null;
  }

  draw() {
    // One column of times for both: uPlot joins them.
    this.plot.setData(uPlot.join([this.series.force_n, this.series.motor_current_a]));
  }
}

// A result that is being computed elsewhere: the page is made again once it is there.
function watch() {
  for (const place of document.querySelectorAll("[data-watch]")) {
    follow(place.dataset.watch, {
      live(lines) { for (const line of lines) if (line.kind === "progress") showProgress(line, place); },
      log() {},
      state(state) { if (!state.is_running) location.reload(); },
    });
    place.removeAttribute("data-watch");
  }
}

document.addEventListener("submit", async (event) => {
  const form = event.target;
  if (!form.dataset.quiet) return;
  event.preventDefault();
  const input = form.querySelector("input[name=text]");
  if (input && !input.value.trim()) return;
  const answer = await fetch(form.action, { method: "POST", body: new URLSearchParams(new FormData(form)) });
  form.querySelector(".said").textContent = answer.ok ? form.dataset.quiet + (input ? input.value : "") : "not accepted, reload the page";
  if (input && answer.ok) input.value = "";
});

// The page before, with what was entered in its form; without script its address alone.
document.addEventListener("click", (event) => {
  if (!event.target.closest("[data-back]") || history.length < 2) return;
  event.preventDefault();
  history.back();
});

document.addEventListener("change", (event) => {
  const name = event.target.dataset.all;
  if (!name) return;
  for (const box of document.querySelectorAll(`input[name="${name}"]`)) box.checked = event.target.checked;
});

document.addEventListener("DOMContentLoaded", () => {
  const live = byId("live");
  if (live) watchJob(live);
  watch();
  document.querySelector("#step [data-focus]")?.focus();
});
