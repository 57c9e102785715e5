// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
"use strict";
// Draws the panels of a run report on canvases. All panels share one x range: drag to zoom, double-click for all.
(() => {
  const report = JSON.parse(document.getElementById("data").textContent);
  const LEFT = 78, RIGHT = 136, TOP = 24, dark = window.matchMedia("(prefers-color-scheme: dark)");
  const FONT = '12px "DejaVu Sans", "Segoe UI", system-ui, sans-serif';
  let view = report.range.slice(), cursor = null, drag = null, INK, MUTED, RULE, PAPER;

  function look() {  // colours of the page, light or dark
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    [INK, MUTED, RULE, PAPER] = ["--ink", "--muted", "--rule", "--paper"].map(color);
  }

  function lit(color) {  // a line's colour that can be told from the page
    if (!dark.matches) return color;
    const parts = [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
    return Math.max(...parts) < 80 ? INK : `rgb(${parts.map((v) => Math.round(v + 0.45 * (255 - v))).join(", ")})`;
  }

  function ticks(low, high, count) {
    const raw = (high - low) / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw) || raw;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), out = [];
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) {
      out.push([i * step, Math.abs(i * step) >= 1e5 || (step < 1e-4) ? (i * step).toExponential(1) : (i * step).toFixed(digits)]);
    }
    return out;
  }

  const at = (line, x) => {  // index of the last point at or before x
    let low = 0, high = line.x.length;
    while (low < high) { const mid = (low + high) >> 1; if (line.x[mid] <= x) low = mid + 1; else high = mid; }
    return low - 1;
  };

  function bounds(panel) {
    let low = Infinity, high = -Infinity;
    for (const line of panel.lines) {
      for (let i = Math.max(0, at(line, view[0])); i < line.x.length && line.x[i] <= view[1]; i += 1) {
        const y = line.y[i];
        if (y !== null) { low = Math.min(low, y); high = Math.max(high, y); }
      }
    }
    if (low > high) [low, high] = [0, 1];
    for (const limit of panel.limits) {
      if (limit >= low - (high - low) && limit <= high + (high - low)) { low = Math.min(low, limit); high = Math.max(high, limit); }
    }
    if (panel.zero) low = Math.min(low, 0);
    const pad = (high - low) * 0.08 || Math.abs(high) * 0.1 || 1;
    return [low - (panel.zero && low === 0 ? 0 : pad), high + pad];
  }

  function prepare(canvas, height) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth;
    canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    g.font = FONT;
    const X = (x) => LEFT + (x - view[0]) / (view[1] - view[0]) * (width - LEFT - RIGHT);
    return { g, width, height, X };
  }

  function clip(c) { c.g.save(); c.g.beginPath(); c.g.rect(LEFT, 0, c.width - LEFT - RIGHT, c.height); c.g.clip(); }

  function drawBands(c, bottom) {
    clip(c);
    for (const [from, to, fill] of report.bands) {
      c.g.globalAlpha = dark.matches ? 0.25 : 1;
      c.g.fillStyle = fill;
      c.g.fillRect(c.X(from), TOP, c.X(to) - c.X(from), bottom - TOP);
    }
    c.g.restore();
  }

  function drawLine(c, line, Y) {
    const g = c.g;
    g.strokeStyle = g.fillStyle = lit(line.color); g.lineWidth = line.width; g.setLineDash(line.dash);
    g.beginPath();
    let up = true, last = 0;
    const stop = Math.min(line.x.length, at(line, view[1]) + 2);
    for (let i = Math.max(0, at(line, view[0])); i < stop; i += 1) {
      const y = line.y[i];
      if (y === null) { up = true; continue; }
      const px = c.X(line.x[i]), py = Y(y);
      if (line.dots) { g.fillRect(px - 1.2, py - 1.2, 2.4, 2.4); continue; }
      if (up) g.moveTo(px, py);
      else { if (line.step) g.lineTo(px, last); g.lineTo(px, py); }
      up = false; last = py;
    }
    g.stroke(); g.setLineDash([]);
  }

  function drawNames(c, panel, Y, bottom) {
    const ends = panel.lines.map((line) => {
      let i = cursor === null ? Math.min(line.x.length - 1, at(line, view[1])) : at(line, cursor);
      while (cursor === null && i > 0 && line.y[i] === null) i -= 1;
      const y = i >= 0 ? line.y[i] : null;
      const value = y === null ? "–" : Number(y.toPrecision(5)).toString();
      return { y: y === null ? Y.mid : Y(y), color: lit(line.color), text: cursor === null ? line.name : `${line.name} ${value}` };
    }).sort((a, b) => a.y - b.y);
    ends.forEach((end, i) => { end.y = Math.max(end.y, i ? ends[i - 1].y + 14 : TOP); });
    for (let i = ends.length - 1, low = bottom; i >= 0; low = ends[i].y - 14, i -= 1) ends[i].y = Math.min(ends[i].y, low);
    for (const end of ends) {
      c.g.fillStyle = end.color; c.g.textAlign = "left"; c.g.textBaseline = "middle";
      c.g.fillText(end.text, c.width - RIGHT + 8, end.y);
    }
  }

  function drawAxis(c, bottom, last) {
    const g = c.g;
    g.strokeStyle = RULE; g.lineWidth = 1; g.fillStyle = MUTED; g.textAlign = "center"; g.textBaseline = "top";
    for (const [x, text] of ticks(view[0], view[1], Math.max(3, (c.width - LEFT - RIGHT) / 90))) {
      g.beginPath(); g.moveTo(c.X(x), bottom); g.lineTo(c.X(x), bottom + 4); g.stroke();
      if (last) g.fillText(text, c.X(x), bottom + 7);
    }
    if (last) g.fillText(report.label, (LEFT + c.width - RIGHT) / 2, bottom + 24);
  }

  function drawCursor(c, bottom) {
    const g = c.g;
    if (cursor !== null) {
      g.strokeStyle = MUTED; g.lineWidth = 1; g.beginPath();
      g.moveTo(c.X(cursor), TOP); g.lineTo(c.X(cursor), bottom); g.stroke();
    }
    if (drag) {
      g.fillStyle = "rgba(11, 92, 158, .12)";
      g.fillRect(c.X(drag[0]), TOP, c.X(drag[1]) - c.X(drag[0]), bottom - TOP);
    }
  }

  function drawPanel(canvas, panel, last) {
    const c = prepare(canvas, panel.height + (last ? 44 : 8)), g = c.g, bottom = panel.height;
    const [low, high] = bounds(panel);
    const Y = (y) => bottom - (y - low) / (high - low) * (bottom - TOP);
    Y.mid = (TOP + bottom) / 2;
    drawBands(c, bottom);
    g.textAlign = "right"; g.textBaseline = "middle";
    for (const [y, text] of ticks(low, high, panel.height / 28)) {
      g.strokeStyle = RULE; g.lineWidth = 0.7;
      g.beginPath(); g.moveTo(LEFT, Y(y)); g.lineTo(c.width - RIGHT, Y(y)); g.stroke();
      g.fillStyle = MUTED; g.fillText(text, LEFT - 8, Y(y));
    }
    clip(c);
    g.strokeStyle = INK; g.setLineDash([1, 2]); g.lineWidth = 1;
    for (const limit of panel.limits) { g.beginPath(); g.moveTo(LEFT, Y(limit)); g.lineTo(c.width - RIGHT, Y(limit)); g.stroke(); }
    g.setLineDash([]);
    for (const line of panel.lines) drawLine(c, line, Y);
    g.restore();
    drawCursor(c, bottom);
    g.fillStyle = INK; g.textAlign = "left"; g.textBaseline = "alphabetic"; g.fillText(panel.title, LEFT, TOP - 8);
    drawNames(c, panel, Y, bottom);
    drawAxis(c, bottom, last);
  }

  function drawStrips(canvas, panel, last) {
    const row = 22, bottom = TOP + row * panel.strips.length;
    const c = prepare(canvas, bottom + (last ? 44 : 8)), g = c.g;
    panel.strips.forEach((strip, i) => {
      const top = TOP + i * row;
      g.fillStyle = INK; g.textAlign = "right"; g.textBaseline = "middle";
      g.fillText(strip.name, LEFT - 8, top + row / 2);
      clip(c);
      for (const [from, to, look, words] of strip.parts) {
        const a = c.X(from), b = c.X(to), style = report.looks[look];
        const empty = style.fill === "#ffffff", pale = empty || (dark.matches && style.text === "#5f6368");
        g.fillStyle = empty ? PAPER : pale ? RULE : style.fill; g.fillRect(a, top + 1.5, b - a, row - 3);
        g.strokeStyle = RULE; g.strokeRect(a + 0.5, top + 2, b - a - 1, row - 4);
        const left = Math.max(a, LEFT), right = Math.min(b, c.width - RIGHT);
        const text = [words, style.word].find((t) => g.measureText(t).width < right - left - 8);
        g.fillStyle = pale ? MUTED : style.text; g.textAlign = "center";
        if (text) g.fillText(text, (left + right) / 2, top + row / 2 + 0.5);
      }
      g.restore();
      if (cursor !== null) {
        const part = strip.parts.find(([from, to]) => from <= cursor && cursor < to);
        g.fillStyle = MUTED; g.textAlign = "left";
        if (part) g.fillText(report.looks[part[2]].word, c.width - RIGHT + 8, top + row / 2);
      }
    });
    g.fillStyle = INK; g.textAlign = "left"; g.textBaseline = "alphabetic"; g.fillText(panel.title, LEFT, TOP - 8);
    drawCursor(c, bottom);
    drawAxis(c, bottom, last);
  }

  const host = document.getElementById("panels");
  const canvases = report.panels.map((panel) => {
    const box = document.createElement("div"), canvas = document.createElement("canvas");
    box.className = "panel"; canvas.setAttribute("role", "img"); canvas.setAttribute("aria-label", panel.title);
    box.append(canvas); host.append(box);
    return canvas;
  });

  function draw() {
    look();
    report.panels.forEach((panel, i) => {
      (panel.strips ? drawStrips : drawPanel)(canvases[i], panel, i === canvases.length - 1);
    });
  }

  const toX = (canvas, event) => {
    const box = canvas.getBoundingClientRect(), share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return view[0] + Math.min(1, Math.max(0, share)) * (view[1] - view[0]);
  };
  for (const canvas of canvases) {
    canvas.addEventListener("pointermove", (e) => { cursor = toX(canvas, e); if (drag) drag[1] = cursor; draw(); });
    canvas.addEventListener("pointerleave", () => { cursor = null; if (!drag) draw(); });
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); drag = [toX(canvas, e), toX(canvas, e)]; });
    canvas.addEventListener("pointerup", () => {
      const [a, b] = [Math.min(...drag), Math.max(...drag)];
      drag = null;
      if (b - a > (view[1] - view[0]) / 200) view = [a, b];
      draw();
    });
    canvas.addEventListener("dblclick", () => { view = report.range.slice(); draw(); });
  }
  window.addEventListener("resize", draw);
  dark.addEventListener("change", draw);
  draw();
})();
