// Interactive charts. Their data are in the page; nothing is fetched.
(function () {
  "use strict";

  const INK = "#52606d";
  const LINE = "#e4e8ec";
  const FONT = "12px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";

  // 1.5e-9 as journals print it.
  function powered(text) {
    return text.replace(/e([+-])(\d+)$/, function (_, sign, power) {
      return "×10" + (sign === "-" ? "⁻" : "") + power.replace(/\d/g, function (digit) { return "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]; });
    });
  }

  // The same number format as in the rest of the report.
  function shown(value, unit) {
    if (value === null || value === undefined) { return "–"; }
    const size = Math.abs(value);
    const digits = size >= 1e7 || (size > 0 && size < 1e-4) ? powered(value.toExponential(3))
      : size >= 9999.5 ? value.toFixed(0).replace(/\B(?=(\d{3})+$)/g, ",") : size === 0 ? "0" : value.toPrecision(4);
    return digits.replace(/^-/, "−") + (unit && unit !== "1" ? " " + unit : "");
  }

  // The marks of an axis, as exact as their step: uPlot's own have three decimals, in the language of the browser, where
  // 1.200 may be 1200.
  function marks(plot, values, axis, space, step) {
    const power = Math.floor(Math.log10(step)), steps = step / 10 ** power;
    const decimals = (Math.abs(steps - Math.round(steps)) > 1e-6 ? 1 : 0) - power;
    const size = Math.max(...values.map(Math.abs)), places = Math.min(20, Math.max(0, decimals));
    const plain = new Intl.NumberFormat("en", { minimumFractionDigits: places, maximumFractionDigits: places });
    return values.map(function (value) {
      if (value === 0 || (size >= 1e-4 && size < 1e16)) { return plain.format(value || 0).replace(/^-/, "−"); }
      const digits = decimals + Math.floor(Math.log10(Math.abs(value)));
      return powered(value.toExponential(Math.min(20, Math.max(0, digits)))).replace(/^-/, "−");
    });
  }

  function faded(colour, share) {
    return colour + Math.round(share * 255).toString(16).padStart(2, "0");
  }

  function element(name, attributes, text) {
    const made = document.createElement(name);
    Object.entries(attributes || {}).forEach(function (pair) { made.setAttribute(pair[0], pair[1]); });
    if (text !== undefined) { made.textContent = text; }
    return made;
  }

  // Wide marks such as 1,200,000 need more room, or the axis label would overlap them.
  function roomForMarks(plot, marks) {
    return Math.max(54, 12 + 7 * Math.max(0, ...(marks || []).map((mark) => String(mark || "").length)));
  }

  const WHOLE = [1, 2, 5].concat(...[1, 2, 3, 4, 5, 6].map((zeros) => [1, 2, 5].map((step) => step * 10 ** zeros)));

  function axes(xLabel, yLabel, steps) {
    const common = { values: marks, stroke: INK, font: FONT, labelFont: FONT, ticks: { stroke: LINE, size: 4 }, labelSize: 22 };
    return [
      Object.assign({ label: xLabel, size: 34, grid: { show: false } }, steps ? { incrs: steps } : {}, common),
      Object.assign({ label: yLabel, size: roomForMarks, grid: { stroke: LINE, width: 1 } }, common),
    ];
  }

  function heightFor(width) {
    return Math.round(Math.max(240, Math.min(380, width * 0.46)));
  }

  // A chart is rebuilt when its content changes, and resized with the page.
  function mount(plot, make) {
    let chart = null;
    function draw() {
      if (chart) { chart.destroy(); }
      const width = plot.clientWidth || 600;
      chart = make(width, heightFor(width));
      return chart;
    }
    draw();
    new ResizeObserver(function () {
      const width = plot.clientWidth;
      if (chart && width && Math.abs(width - chart.width) > 1) { chart.setSize({ width: width, height: heightFor(width) }); }
    }).observe(plot);
    return draw;
  }

  function choice(controls, names, chosen, choose) {
    const buttons = names.map(function (name, place) {
      const button = element("button", { type: "button", "aria-pressed": String(place === chosen) }, name);
      button.addEventListener("click", function () {
        buttons.forEach(function (each) { each.setAttribute("aria-pressed", String(each === button)); });
        choose(place);
      });
      controls.append(button);
      return button;
    });
  }

  function swatch(group) {
    const space = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(space, "svg");
    svg.setAttribute("width", "22");
    svg.setAttribute("height", "10");
    svg.setAttribute("aria-hidden", "true");
    const line = document.createElementNS(space, "line");
    Object.entries({ x1: 0, x2: 22, y1: 5, y2: 5, stroke: group.colour, "stroke-width": 2.5, "stroke-dasharray": (group.dash || []).join(" ") })
      .forEach(function (pair) { line.setAttribute(pair[0], pair[1]); });
    svg.append(line);
    return svg;
  }

  // ---- a sampled measure over the time of the mission

  function course(figure, data) {
    const plot = figure.querySelector(".plot");
    const legend = figure.querySelector(".legend");
    let each = false;
    const hidden = new Set();
    const readout = element("p", { class: "readout", "aria-live": "off" }, "Point at the chart for values.");
    plot.before(readout);

    function phaseAt(time) {
      const found = data.phases.find(function (phase) { return phase.start <= time && time < phase.end; });
      return found ? ", " + found.name : "";
    }

    function upright(context, text, x, y, align) {
      context.save();
      context.translate(x, y);
      context.rotate(-Math.PI / 2);
      context.textAlign = align;
      context.fillText(text, 0, 0);
      context.restore();
    }

    function shade(u) {
      const context = u.ctx;
      const top = u.bbox.top, height = u.bbox.height, left = u.bbox.left, right = left + u.bbox.width;
      context.save();
      context.font = 11 * devicePixelRatio + "px system-ui, sans-serif";
      context.textAlign = "center";
      data.phases.forEach(function (phase, place) {
        const from = Math.max(left, u.valToPos(phase.start, "x", true));
        const to = Math.min(right, u.valToPos(phase.end, "x", true));
        if (to <= from) { return; }
        if (place % 2) { context.fillStyle = "#f3f5f8"; context.fillRect(from, top, to - from, height); }
        context.fillStyle = INK;
        if (context.measureText(phase.name).width + 4 < to - from) {
          context.fillText(phase.name, (from + to) / 2, top + 13 * devicePixelRatio);
        } else if (to - from > 12 * devicePixelRatio) {
          upright(context, phase.name, (from + to) / 2 + 4 * devicePixelRatio, top + 4 * devicePixelRatio, "right");
        }
      });
      context.strokeStyle = "#9aa5b1";
      context.fillStyle = INK;
      context.setLineDash([4, 4]);
      data.events.forEach(function (event) {
        const at = Math.round(u.valToPos(event.at, "x", true));
        if (at < left || at > right) { return; }
        context.beginPath();
        context.moveTo(at, top);
        context.lineTo(at, top + height);
        context.stroke();
        if (right - left < 400 * devicePixelRatio) { return; }
        const isEarly = at < (left + right) / 2;
        const courses = data.groups.map(function (group) { return group.middle[isEarly ? 2 : group.middle.length - 3]; });
        const isHigh = courses.some(function (value) { return value !== null && u.valToPos(value, "y", true) < top + height * 0.4; });
        const y = isHigh ? top + height - 4 * devicePixelRatio : top + 20 * devicePixelRatio;
        upright(context, event.name, at + (isEarly ? 11 : -4) * devicePixelRatio, y, isHigh ? "left" : "right");
      });
      context.restore();
    }

    function lines() {
      const columns = [data.time];
      const series = [{}];
      const bands = [];
      data.groups.forEach(function (group) {
        const show = !hidden.has(group.name);
        if (each) {
          group.each.forEach(function (run) {
            columns.push(run.values);
            series.push({ label: run.name, group: group, show: show, stroke: faded(group.colour, 0.75), width: 1, points: { show: false } });
          });
          return;
        }
        const first = series.length;
        columns.push(group.high, group.low, group.middle);
        const edge = { show: show, width: 0, points: { show: false } };
        series.push(Object.assign({}, edge), Object.assign({}, edge));
        series.push({ label: group.name, group: group, isMean: true, show: show, stroke: group.colour, width: 2, dash: group.dash, points: { show: false } });
        bands.push({ series: [first, first + 1], fill: faded(group.colour, 0.18) });
      });
      return { columns: columns, series: series, bands: bands };
    }

    function nearestRun(u, place) {
      let nearest = 18, run = "";
      u.series.forEach(function (line, number) {
        const value = number && line.show ? u.data[number][place] : null;
        if (value === null || value === undefined) { return; }
        const distance = Math.abs(u.valToPos(value, "y") - u.cursor.top);
        if (distance < nearest) { nearest = distance; run = line.label + " (" + line.group.name + ") " + shown(value, data.unit); }
      });
      return run;
    }

    function tell(u) {
      const place = u.cursor.idx;
      if (place === null || place === undefined || u.cursor.top < 0) { return; }
      const time = data.time[place];
      const values = each ? [nearestRun(u, place)] : data.groups
        .filter(function (group) { return !hidden.has(group.name); })
        .map(function (group) { return group.name + " " + shown(group.middle[place], data.unit); });
      readout.textContent = [shown(time, "s") + phaseAt(time)].concat(values.filter(Boolean)).join("  ·  ");
    }

    const redraw = mount(plot, function (width, height) {
      const what = lines();
      return new uPlot({
        width: width, height: height, series: what.series, bands: what.bands,
        axes: axes("Time since the start of the mission (s)", data.label),
        scales: { x: { time: false, range: function (u, low, high) { return [low <= data.time[0] ? Math.min(0, low) : low, high]; } } },
        legend: { show: false },
        cursor: { drag: { x: true, y: false }, points: { show: !each }, y: each },
        hooks: { drawClear: [shade], setCursor: [tell] },
      }, what.columns, plot);
    });

    choice(figure.querySelector(".controls"), ["Mean of each treatment", "Each run"], 0, function (place) {
      each = place === 1;
      redraw();
    });
    data.groups.forEach(function (group) {
      const button = element("button", { type: "button", "aria-pressed": "true" });
      button.append(swatch(group), element("span", {}, group.name));
      button.addEventListener("click", function () {
        if (!hidden.delete(group.name)) { hidden.add(group.name); }
        button.setAttribute("aria-pressed", String(!hidden.has(group.name)));
        redraw();
      });
      legend.append(button);
    });
  }

  // ---- all runs, one point each

  const SHAPES = {
    o: function (c, x, y, r) { c.arc(x, y, r, 0, 2 * Math.PI); },
    s: function (c, x, y, r) { c.rect(x - r * 0.9, y - r * 0.9, r * 1.8, r * 1.8); },
    "^": function (c, x, y, r) { c.moveTo(x, y - r * 1.15); c.lineTo(x + r * 1.1, y + r * 0.85); c.lineTo(x - r * 1.1, y + r * 0.85); c.closePath(); },
    v: function (c, x, y, r) { c.moveTo(x, y + r * 1.15); c.lineTo(x + r * 1.1, y - r * 0.85); c.lineTo(x - r * 1.1, y - r * 0.85); c.closePath(); },
    D: function (c, x, y, r) { c.moveTo(x, y - r * 1.25); c.lineTo(x + r * 1.25, y); c.lineTo(x, y + r * 1.25); c.lineTo(x - r * 1.25, y); c.closePath(); },
  };

  function shape(context, marker, x, y, radius) {
    context.beginPath();
    (SHAPES[marker] || SHAPES.o)(context, x, y, radius);
  }

  function points(figure, data) {
    const plot = figure.querySelector(".plot");
    const legend = figure.querySelector(".legend");
    const tip = element("div", { class: "tip", hidden: "" });
    const hidden = new Set();
    let measure = data.measures[0];

    function isShown(place) {
      return measure.values[place] !== null && !hidden.has(data.group[place]);
    }

    function dots(u) {
      const context = u.ctx;
      context.save();
      context.beginPath();
      context.rect(u.bbox.left - 8, u.bbox.top - 8, u.bbox.width + 16, u.bbox.height + 16);
      context.clip();
      data.order.forEach(function (order, place) {
        if (!isShown(place)) { return; }
        const group = data.groups[data.group[place]];
        shape(context, group.marker, u.valToPos(order, "x", true), u.valToPos(measure.values[place], "y", true), 5 * devicePixelRatio);
        context.fillStyle = faded(group.colour, 0.9);
        context.strokeStyle = "#fff";
        context.lineWidth = devicePixelRatio;
        context.fill();
        context.stroke();
      });
      context.restore();
    }

    function tell(u) {
      let nearest = 26, found = -1;
      data.order.forEach(function (order, place) {
        if (!isShown(place)) { return; }
        const distance = Math.hypot(u.valToPos(order, "x") - u.cursor.left, u.valToPos(measure.values[place], "y") - u.cursor.top);
        if (u.cursor.left >= 0 && distance < nearest) { nearest = distance; found = place; }
      });
      tip.hidden = found < 0;
      if (found < 0) { return; }
      tip.textContent = data.runs[found] + " · " + data.groups[data.group[found]].name + " · " + measure.texts[found];
      const half = tip.offsetWidth / 2;
      const left = u.valToPos(data.order[found], "x") + u.over.offsetLeft;
      tip.style.left = Math.max(half, Math.min(plot.clientWidth - half, left)) + "px";
      tip.style.top = Math.max(tip.offsetHeight + 12, u.valToPos(measure.values[found], "y") + u.over.offsetTop) + "px";
    }

    const redraw = mount(plot, function (width, height) {
      const values = measure.values.map(function (value, place) { return isShown(place) ? value : null; });
      const chart = new uPlot({
        width: width, height: Math.round(height * 0.8),
        series: [{}, { label: measure.label, stroke: "transparent", width: 0, points: { show: false } }],
        axes: axes(data.place, measure.label, WHOLE),
        scales: {
          x: { time: false, range: function (u, low, high) { return [low - 0.6, high + 0.6]; } },
          y: { range: function (u, low, high) { const by = (high - low || Math.abs(high) || 1) * 0.12; return low === null ? [0, 1] : [low - by, high + by]; } },
        },
        legend: { show: false },
        cursor: { x: false, y: false, drag: { x: false, y: false }, points: { show: false } },
        hooks: { draw: [dots], setCursor: [tell] },
      }, [data.order, values], plot);
      plot.append(tip);
      return chart;
    });

    if (data.measures.length > 1) {
      choice(figure.querySelector(".controls"), data.measures.map(function (each) { return each.name; }), 0, function (place) {
        measure = data.measures[place];
        redraw();
      });
    }
    if (data.groups.length < 2 || data.groups.length > 12) { return; }
    data.groups.forEach(function (group, number) {
      const button = element("button", { type: "button", "aria-pressed": "true" });
      const canvas = element("canvas", { width: "24", height: "24", style: "width:12px;height:12px", "aria-hidden": "true" });
      const context = canvas.getContext("2d");
      shape(context, group.marker, 12, 12, 8);
      context.fillStyle = group.colour;
      context.fill();
      button.append(canvas, element("span", {}, group.name));
      button.addEventListener("click", function () {
        if (!hidden.delete(number)) { hidden.add(number); }
        button.setAttribute("aria-pressed", String(!hidden.has(number)));
        redraw();
      });
      legend.append(button);
    });
  }

  const KINDS = { course: course, points: points };
  document.querySelectorAll("figure.chart").forEach(function (figure) {
    KINDS[figure.dataset.chart](figure, JSON.parse(figure.querySelector("script").textContent));
  });
})();
