// Draws each figure that carries its data as a plot that can be zoomed and read off. Without script, and on paper, the
// drawing itself is shown.
(function () {
  "use strict";
  const ZOOM = 0.6, SHIFT = 0.3, STEP_PX = 4, NARROW_PX = 640, LEAST_HEIGHT_PX = 150, AXIS_PX = 56;
  const GRID = "#e3e6e8", AXIS = "#52595f", FONT = "12px system-ui, sans-serif";

  // Numbers travel as whole multiples of a quantum, each as its difference from the one before; null breaks a line.
  function decode(coded) {
    let sum = 0;
    return coded.steps.map((step) => (step === null ? null : (sum += step) / coded.per_unit));
  }

  function element(tag, properties, ...children) {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  }

  function swatchOf(colour) {
    const made = element("span", { className: "chart-swatch" });
    made.style.background = colour;
    return made;
  }

  function shown(value) {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e6 || size < 1e-4)) return value.toExponential(3);
    return String(Number(value.toPrecision(size >= 1e4 ? 6 : 5)));
  }

  // Powers of ten, with 2 and 5 between where there is room.
  function logTicks(low, high) {
    const factors = high / low > 1e3 ? [1] : [1, 2, 5], found = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
      found.push(...factors.map((factor) => factor * 10 ** power));
    }
    return found.filter((tick) => tick >= low && tick <= high);
  }

  class Panel {
    constructor(spec, chart) {
      this.spec = spec;
      this.chart = chart;
      this.series = spec.series.map((one) => ({ ...one, x: decode(one.x), y: decode(one.y) }));
      this.shapes = spec.shapes.map((one) => ({ ...one, paths: one.paths.map(([x, y]) => [decode(x), decode(y)]) }));
      this.hidden = new Set();
      this.readouts = [];
      this.at = element("span", { className: "chart-at" });
      this.box = element("div", { className: "chart-plot" });
      this.box.setAttribute("aria-hidden", "true");
      const head = element("div", { className: "chart-head" }, ...this.keys(), this.at);
      this.root = element("div", { className: "chart-panel" });
      if (spec.title && this.labels().join() !== spec.title) this.root.append(element("p", { className: "chart-title", textContent: spec.title }));
      if (spec.note) this.root.append(element("p", { className: "chart-note", textContent: spec.note }));
      this.root.append(head, this.box);
    }

    labels() {
      return [...new Set([...this.series, ...this.shapes].map((one) => one.label).filter(Boolean))];
    }

    // Names stand once, in the tools of the figure; a panel shows the values of its own colours.
    keys() {
      const labels = this.labels();
      return labels.map((label) => {
        const value = element("span", { className: "chart-value" });
        const isAlone = labels.length === 1;
        this.readouts.push([label, value]);
        return element(
          "span", { className: isAlone ? "chart-key chart-alone" : "chart-key" }, swatchOf(this.colourOf(label)), isAlone ? label : "", value,
        );
      });
    }

    colourOf(label) {
      const owner = [...this.series, ...this.shapes].find((one) => one.label === label);
      return owner && owner.colour;
    }

    draw() {
      const spec = this.spec;
      const data = uPlot.join(this.series.map((one) => [one.x, one.y]));
      const scale = (is_log) => (is_log ? { distr: 3 } : {});
      this.plot = new uPlot(
        {
          ...this.size(),
          legend: { show: false },
          cursor: {
            drag: { x: true, y: false, setScale: false }, points: { size: 6 }, y: false,
            bind: { dblclick: () => () => this.chart.reset() },
          },
          scales: {
            x: { time: false, ...scale(spec.x.is_log), range: () => this.window || spec.x.range },
            y: { ...scale(spec.y.is_log), range: (u, low, high) => this.yRange(low, high) },
          },
          axes: [this.axis(spec.x, 26), this.axis(spec.y, AXIS_PX)],
          series: [{}, ...this.series.map((one) => this.line(one))],
          hooks: {
            drawClear: [(u) => this.drawShapes(u)],
            draw: [(u) => this.drawGuides(u)],
            setCursor: [() => this.chart.hover(this)],
            setSelect: [(u) => this.chart.zoom(this, u.select)],
          },
        },
        data,
        this.box,
      );
    }

    axis(spec, size) {
      const angles = spec.is_angle ? { incrs: [0.5, 1, 2, 5, 10, 15, 30, 45, 90] } : {};
      const isWhole = spec === this.spec.x && this.series.every((one) => one.x.every(Number.isInteger));
      const wholes = isWhole && !spec.is_angle ? { incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] } : {};
      const decades = spec.is_log ? { splits: (u, k, low, high) => logTicks(low, high), filter: (u, ticks) => ticks } : {};
      // Of panels above one another the lowest carries the numbers.
      const isBare = spec === this.spec.x && !spec.label && this.chart.panels.length > 1;
      return {
        label: spec.label || undefined, labelSize: 18, labelGap: 0, size: isBare ? 8 : size, font: FONT, labelFont: FONT, stroke: AXIS,
        grid: { stroke: GRID, width: 1 }, ticks: { stroke: GRID, width: 1, size: 4 },
        values: (u, ticks) => ticks.map((tick) => (isBare ? "" : shown(tick))), ...angles, ...wholes, ...decades,
      };
    }

    line(one) {
      return {
        label: one.label, stroke: one.colour, width: one.width, dash: one.dash.length ? one.dash : undefined,
        points: { show: one.has_points, size: 6, fill: one.colour }, alpha: one.alpha,
      };
    }

    size() {
      const width = this.box.clientWidth || this.root.clientWidth || 600;
      const height = Math.max(LEAST_HEIGHT_PX, this.spec.height);
      return { width, height: width < NARROW_PX ? Math.min(height, 260) : height };
    }

    // The whole panel keeps the range of the drawing; a part of it fills the height.
    yRange(low, high) {
      if (!this.window) return this.spec.y.range;
      for (const shape of this.shapes) {
        if (this.hidden.has(shape.label) || shape.is_span) continue;
        for (const [x, y] of shape.paths) {
          x.forEach((at, k) => {
            if (at < this.window[0] || at > this.window[1]) return;
            low = low === null ? y[k] : Math.min(low, y[k]);
            high = high === null ? y[k] : Math.max(high, y[k]);
          });
        }
      }
      if (low === null || high === null) return this.spec.y.range;
      if (this.spec.y.is_log) return [low / 1.2, high * 1.2];
      const pad = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
      return [low - pad, high + pad];
    }

    show(window) {
      const [low, high] = this.spec.x.range;
      if (window) {
        const width = Math.min(window[1] - window[0], high - low);
        const start = Math.min(Math.max(window[0], low), high - width);
        window = width < 0.9999 * (high - low) ? [start, start + width] : null;
      }
      this.window = window;
      const [min, max] = window || [low, high];
      this.plot.setScale("x", { min, max });
    }

    drawShapes(u) {
      const context = u.ctx, box = u.bbox;
      context.save();
      context.beginPath();
      context.rect(box.left, box.top, box.width, box.height);
      context.clip();
      for (const shape of this.shapes) {
        if (this.hidden.has(shape.label)) continue;
        context.globalAlpha = shape.alpha;
        context.fillStyle = context.strokeStyle = shape.colour;
        context.lineWidth = 1.2 * uPlot.pxRatio;
        for (const [x, y] of shape.paths) {
          context.beginPath();
          x.forEach((at, k) => {
            const top = shape.is_span ? (k === 0 || k === 3 ? box.top : box.top + box.height) : u.valToPos(y[k], "y", true);
            context.lineTo(u.valToPos(at, "x", true), top);
          });
          if (shape.is_filled) context.fill();
          else context.stroke();
        }
      }
      context.restore();
    }

    drawGuides(u) {
      const context = u.ctx, box = u.bbox, ratio = uPlot.pxRatio;
      context.save();
      context.beginPath();
      context.rect(box.left, box.top, box.width, box.height);
      context.clip();
      for (const guide of this.spec.guides) {
        context.strokeStyle = guide.colour;
        context.lineWidth = guide.width * ratio;
        context.setLineDash(guide.dash.map((length) => length * ratio));
        const at = Math.round(u.valToPos(guide.at, guide.axis, true));
        context.beginPath();
        if (guide.axis === "x") context.moveTo(at, box.top), context.lineTo(at, box.top + box.height);
        else context.moveTo(box.left, at), context.lineTo(box.left + box.width, at);
        context.stroke();
      }
      context.font = `${12 * ratio}px system-ui, sans-serif`;
      context.textBaseline = "middle";
      context.textAlign = "left";
      for (const text of this.spec.texts) {
        context.fillStyle = text.colour;
        context.fillText(text.text, u.valToPos(text.x, "x", true), u.valToPos(text.y, "y", true));
      }
      context.restore();
    }

    // Of each line the sample nearest to the cursor.
    read() {
      const left = this.plot.cursor.left;
      const isOn = left !== null && left !== undefined && left >= 0;
      const at = isOn ? this.plot.posToVal(left, "x") : null;
      this.at.textContent = isOn ? `${this.spec.x.name} ${shown(at)}${this.spec.x.unit}` : "";
      for (const [label, output] of this.readouts) {
        const one = this.series.find((series) => series.label === label);
        output.textContent = isOn && one && !this.hidden.has(label) ? shown(nearest(one, at)) + this.spec.y.unit : "";
      }
      return at;
    }

    point(at) {
      const left = at === null ? -10 : this.plot.valToPos(at, "x");
      this.plot.setCursor({ left, top: at === null ? -10 : 1 }, false);
      this.read();
    }
  }

  function nearest(one, at) {
    let low = 0, high = one.x.length - 1;
    if (high < 0 || at < one.x[0] || at > one.x[high]) return null;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (one.x[middle] <= at) low = middle;
      else high = middle;
    }
    return at - one.x[low] <= one.x[high] - at ? one.y[low] : one.y[high];
  }

  class Chart {
    constructor(svg) {
      const spec = JSON.parse(svg.dataset.chart);
      this.isBusy = false;
      this.panels = spec.panels.map((panel) => new Panel(panel, this));
      const grid = element("div", { className: "chart-grid" }, ...this.panels.map((panel) => panel.root));
      grid.style.setProperty("--columns", spec.n_columns);
      // In one column, panels without a title follow the one that stands above them.
      const isNamedOnce = spec.panels.every((one, k) => k < spec.n_columns || !one.title);
      this.panels.forEach((panel, k) => panel.root.style.setProperty("--place", isNamedOnce ? k % spec.n_columns : 0));
      this.root = element("div", { className: "chart" }, this.tools(), grid);
      this.root.setAttribute("role", "group");
      this.root.setAttribute("aria-label", svg.querySelector("title").textContent);
      svg.before(this.root);
      svg.classList.add("replaced");
      this.panels.forEach((panel) => panel.draw());
      this.root.addEventListener("keydown", (event) => this.onKey(event));
      new ResizeObserver(() => this.panels.forEach((panel) => panel.plot.setSize(panel.size()))).observe(grid);
    }

    tools() {
      const made = [
        ["Zoom in", "+", () => this.scale(ZOOM)], ["Zoom out", "−", () => this.scale(1 / ZOOM)],
        ["Left", "◀", () => this.shift(-SHIFT)], ["Right", "▶", () => this.shift(SHIFT)],
        ["Show all", "Show all", () => this.reset()],
      ].map(([label, textContent, action]) => {
        const button = element("button", { type: "button", textContent });
        if (label !== textContent) button.title = label, button.setAttribute("aria-label", label);
        button.addEventListener("click", action);
        return button;
      });
      return element("div", { className: "chart-tools" }, ...this.toggles(), element("span", { className: "chart-space" }), ...made);
    }

    // With every colour that a name has in one of the panels.
    toggles() {
      const labels = this.panels.map((panel) => panel.labels()).filter((names) => names.length > 1).flat();
      return [...new Set(labels)].map((label) => {
        const colours = new Set(this.panels.map((panel) => panel.colourOf(label)).filter(Boolean));
        const swatches = [...colours].map(swatchOf);
        const button = element("button", { className: "chart-toggle", type: "button" }, ...swatches, label);
        button.setAttribute("aria-pressed", "true");
        button.addEventListener("click", () => button.setAttribute("aria-pressed", String(this.toggle(label))));
        return button;
      });
    }

    onKey(event) {
      const move = { ArrowLeft: -STEP_PX, ArrowRight: STEP_PX }[event.key];
      if (move) {
        const panel = this.last || this.panels[0];
        const left = panel.plot.cursor.left, width = panel.plot.over.clientWidth;
        const next = left === null || left === undefined || left < 0 ? width / 2 : Math.min(Math.max(left + move, 0), width);
        panel.plot.setCursor({ left: next, top: 1 });
      } else if (event.key === "+") this.scale(ZOOM);
      else if (event.key === "-") this.scale(1 / ZOOM);
      else if (event.key === "0") this.reset();
      else return;
      event.preventDefault();
    }

    // Hide or show a name in every panel; returns whether it is shown now.
    toggle(label) {
      let isShown = true;
      for (const panel of this.panels) {
        isShown = panel.hidden.delete(label);
        if (!isShown) panel.hidden.add(label);
        panel.series.forEach((one, k) => one.label === label && panel.plot.setSeries(k + 1, { show: isShown }));
        panel.plot.redraw();
      }
      return isShown;
    }

    linked(panel) {
      return this.panels.filter((other) => other !== panel && other.plot && other.spec.group === panel.spec.group);
    }

    // Once, however many plots answer.
    once(action) {
      if (this.isBusy) return;
      this.isBusy = true;
      try {
        action();
      } finally {
        this.isBusy = false;
      }
    }

    hover(panel) {
      if (!panel.plot) return;
      this.once(() => {
        const at = panel.read();
        this.last = panel;
        this.linked(panel).forEach((other) => other.point(at));
      });
    }

    // A drag inside a plot: its linked plots follow.
    zoom(panel, { left, width }) {
      if (!panel.plot || width < 2) return;
      const window = [panel.plot.posToVal(left, "x"), panel.plot.posToVal(left + width, "x")];
      panel.plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      this.once(() => [panel, ...this.linked(panel)].forEach((other) => other.show(window)));
    }

    each(change) {
      this.once(() => this.panels.forEach((panel) => panel.show(change(panel.window || panel.spec.x.range))));
    }

    scale(factor) {
      this.each(([low, high]) => {
        const middle = 0.5 * (low + high), half = 0.5 * factor * (high - low);
        return [middle - half, middle + half];
      });
    }

    shift(share) {
      this.each(([low, high]) => [low + share * (high - low), high + share * (high - low)]);
    }

    reset() {
      this.each(() => null);
    }
  }

  // Bars, cells and marks say their values beside the pointer; without script a browser shows their titles.
  function sayValues(svg, tip) {
    svg.querySelectorAll(".spots rect").forEach((spot) => {
      spot.dataset.says = spot.textContent;
      spot.replaceChildren();
    });
    svg.addEventListener("pointermove", (event) => {
      const says = event.target.dataset.says;
      tip.hidden = !says;
      tip.textContent = says || "";
      tip.style.left = `${Math.max(4, Math.min(event.clientX + 12, document.documentElement.clientWidth - tip.offsetWidth - 4))}px`;
      tip.style.top = `${event.clientY + 16}px`;
    });
    svg.addEventListener("pointerleave", () => (tip.hidden = true));
  }

  // On paper nobody can open what is closed; a browser that knows ::details-content shows it by the style alone.
  window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => (one.open = true)));
  const tip = element("div", { className: "spot-tip", hidden: true });
  tip.setAttribute("aria-hidden", "true");
  document.body.append(tip);
  document.querySelectorAll("svg").forEach((svg) => svg.querySelector(".spots") && sayValues(svg, tip));
  document.querySelectorAll("svg[data-chart]").forEach((svg) => new Chart(svg));
})();
