// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// A chart as a separate picture, SVG or PNG: drawn again, with a title, on white.
'use strict';

const Picture = (() => {
  const { color } = Chart;
  const HEAD = 30;  // pixels above the chart, for the title

  let pens = 0;

  // The part of a canvas' drawing interface that the charts use, which writes SVG.
  class SvgPen {
    constructor() {
      this.parts = [];
      this.state = { font: '12px sans-serif', fillStyle: '#000', strokeStyle: '#000', lineWidth: 1, lineJoin: 'miter', textAlign: 'start', textBaseline: 'alphabetic', globalAlpha: 1, dash: [], clip: '', turn: '' };
      this.saved = [];
      this.clips = 0;
      pens += 1;  // several pictures in one page must not share the names of their clip paths
      this.name = `p${pens}`;
      this.ruler = document.createElement('canvas').getContext('2d');
      for (const name of Object.keys(this.state)) {
        if (name !== 'clip' && name !== 'turn' && name !== 'dash') {
          Object.defineProperty(this, name, { get: () => this.state[name], set: (value) => { this.state[name] = value; } });
        }
      }
    }
    save() { this.saved.push({ ...this.state }); }
    restore() { this.state = this.saved.pop() || this.state; }
    beginPath() { this.path = ''; }
    moveTo(x, y) { this.path += `M${f(x)} ${f(y)}`; }
    lineTo(x, y) { this.path += `L${f(x)} ${f(y)}`; }
    closePath() { this.path += 'Z'; }
    rect(x, y, w, h) { this.path += `M${f(x)} ${f(y)}h${f(w)}v${f(h)}h${f(-w)}Z`; }
    arc(x, y, r) { this.path += `M${f(x - r)} ${f(y)}a${f(r)} ${f(r)} 0 1 0 ${f(2 * r)} 0a${f(r)} ${f(r)} 0 1 0 ${f(-2 * r)} 0Z`; }
    setLineDash(dash) { this.state.dash = dash; }
    measureText(words) { this.ruler.font = this.font; return this.ruler.measureText(words); }
    turned(x, y) { this.state.turn = ` transform="rotate(-90 ${f(x)} ${f(y)})"`; }
    clip() {
      this.clips += 1;
      this.put(`<clipPath id="${this.name}c${this.clips}"><path d="${this.path}"/></clipPath>`, false);
      this.state.clip = ` clip-path="url(#${this.name}c${this.clips})"`;
    }
    put(markup, clipped = true) { this.parts.push(clipped && this.state.clip ? `<g${this.state.clip}>${markup}</g>` : markup); }
    stroke() {
      const { strokeStyle, lineWidth, dash } = this.state;
      this.put(`<path d="${this.path}" fill="none" stroke="${strokeStyle}" stroke-width="${f(lineWidth)}"${this.faint()}${dash.length ? ` stroke-dasharray="${dash.map(f).join(' ')}"` : ''}/>`);
    }
    fill() { this.put(`<path d="${this.path}" fill="${this.fillStyle}"${this.faint()}/>`); }
    fillRect(x, y, w, h) { this.put(`<rect x="${f(x)}" y="${f(y)}" width="${f(Math.max(w, 0))}" height="${f(Math.max(h, 0))}" fill="${this.fillStyle}"${this.faint()}/>`); }
    strokeText() {}
    fillText(words, x, y) {
      const anchor = { center: 'middle', right: 'end' }[this.textAlign] || 'start';
      const [, weight, size] = this.font.match(/^(\d+ )?([\d.]+)px/);
      this.put(`<text x="${f(x)}" y="${f(y)}" fill="${this.fillStyle}" font-size="${size}"${weight ? ` font-weight="${weight.trim()}"` : ''} text-anchor="${anchor}"${this.textBaseline === 'middle' ? ' dominant-baseline="central"' : ''}${this.state.turn}>${escape(words)}</text>`);
    }
    faint() { return this.globalAlpha < 1 ? ` opacity="${this.globalAlpha}"` : ''; }
  }

  const f = (v) => String(Math.round(v * 10) / 10);
  const escape = (text) => String(text).replace(/[&<>"]/g, (c) => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' })[c]);

  // Draw a chart with its current zoom and switches on any pen.
  function draw(pen, u, title) {
    const ratio = devicePixelRatio;
    const { left, top, width, height } = u.bbox;
    pen.fillStyle = color('paper');
    pen.fillRect(0, -HEAD * ratio, u.ctx.canvas.width, u.ctx.canvas.height + HEAD * ratio);
    pen.textBaseline = 'middle';
    pen.textAlign = 'left';
    pen.font = `600 ${14 * ratio}px system-ui, sans-serif`;
    pen.fillStyle = color('ink');
    pen.fillText(title, left, -HEAD * ratio / 2);
    for (const [i, axis] of u.axes.entries()) ticks(pen, u, axis, i === 0, ratio);
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    for (const band of u.bands) area(pen, u, band);
    u.series.forEach((series, i) => {
      if (i && series.show && series.width && series.stroke && !series.bare) {
        trace(pen, u, u.data[i]);
        pen.setLineDash((series.dash || []).map((d) => d * ratio));
        pen.lineWidth = series.width * ratio;
        pen.strokeStyle = typeof series.stroke === 'function' ? series.stroke(u, i) : series.stroke;
        pen.stroke();
        pen.setLineDash([]);
      }
      if (series.show && series.dots) dots(pen, u, u.data[i], series.stroke(u, i));
    });
    pen.restore();
    if (u.above) u.above({ ...facade(u), ctx: pen });
  }

  // The part of a chart that a drawing hook uses.
  const facade = (u) => ({ bbox: u.bbox, data: u.data, cursor: u.cursor, scales: u.scales, valToPos: (...of) => u.valToPos(...of) });

  function ticks(pen, u, axis, isX, ratio) {
    const { left, top, width, height } = u.bbox;
    const values = axis._splits || [];
    const words = axis._values || [];
    pen.font = `${12 * ratio}px system-ui, sans-serif`;
    values.forEach((value, i) => {
      const at = u.valToPos(value, isX ? 'x' : 'y', true);
      pen.strokeStyle = color('grid');
      pen.lineWidth = ratio;
      pen.beginPath();
      pen.moveTo(isX ? at : left, isX ? top : at);
      pen.lineTo(isX ? at : left + width, isX ? top + height : at);
      pen.stroke();
      if (!words[i]) return;
      pen.fillStyle = color('ink-2');
      pen.textAlign = isX ? 'center' : 'right';
      pen.fillText(words[i], isX ? at : left - 8 * ratio, isX ? top + height + 14 * ratio : at);
    });
    if (!axis.label) return;
    pen.textAlign = 'center';
    pen.fillStyle = color('ink-2');
    if (isX) pen.fillText(axis.label, left + width / 2, top + height + 38 * ratio);
    else {
      pen.save();
      const [x, y] = [12 * ratio, top + height / 2];
      if (pen.turned) {
        pen.turned(x, y);
        pen.fillText(axis.label, x, y);
      } else {
        pen.translate(x, y);
        pen.rotate(-Math.PI / 2);
        pen.fillText(axis.label, 0, 0);
      }
      pen.restore();
    }
  }

  function trace(pen, u, values) {
    pen.beginPath();
    let open = false;
    values.forEach((v, i) => {
      if (v === null || v === undefined) { open = false; return; }
      const [x, y] = [u.valToPos(u.data[0][i], 'x', true), u.valToPos(v, 'y', true)];
      if (open) pen.lineTo(x, y);
      else pen.moveTo(x, y);
      open = true;
    });
  }

  function dots(pen, u, values, ink) {
    pen.fillStyle = ink;
    values.forEach((v, i) => {
      if (v === null || v === undefined) return;
      pen.beginPath();
      pen.arc(u.valToPos(u.data[0][i], 'x', true), u.valToPos(v, 'y', true), 2.5 * devicePixelRatio, 0, 2 * Math.PI);
      pen.fill();
    });
  }

  function area(pen, u, band) {
    const [high, low] = band.series;
    if (!u.series[high].show || !u.series[low].show) return;
    const at = (values, i) => [u.valToPos(u.data[0][i], 'x', true), u.valToPos(values[i], 'y', true)];
    const some = u.data[0].map((_, i) => i).filter((i) => u.data[high][i] !== null && u.data[low][i] !== null);
    pen.beginPath();
    some.forEach((i, j) => (j ? pen.lineTo(...at(u.data[high], i)) : pen.moveTo(...at(u.data[high], i))));
    some.reverse().forEach((i) => pen.lineTo(...at(u.data[low], i)));
    pen.closePath();
    pen.fillStyle = typeof band.fill === 'function' ? band.fill(u, 0) : band.fill;
    pen.fill();
  }

  // Pictures are always drawn in the light colors, because paper is white.
  function onPaper(work) {
    const root = document.documentElement.classList;
    const already = root.contains('printing');
    root.add('printing');
    try { return work(); } finally { if (!already) root.remove('printing'); }
  }

  function svg(u, title) {
    const ratio = devicePixelRatio;
    const [width, height] = [u.ctx.canvas.width, u.ctx.canvas.height + HEAD * ratio];
    const pen = new SvgPen();
    onPaper(() => draw(pen, u, title));
    return `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 ${-HEAD * ratio} ${width} ${height}" width="${width / ratio}" height="${height / ratio}" font-family="system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif">${pen.parts.join('\n')}</svg>\n`;
  }

  // Three pixels for each pixel of the screen, which is sharp in print.
  function png(u, title, done) {
    const [ratio, scale] = [devicePixelRatio, 3 / devicePixelRatio];
    const canvas = document.createElement('canvas');
    canvas.width = u.ctx.canvas.width * scale;
    canvas.height = (u.ctx.canvas.height + HEAD * ratio) * scale;
    const pen = canvas.getContext('2d');
    pen.scale(scale, scale);
    pen.translate(0, HEAD * ratio);
    onPaper(() => draw(pen, u, title));
    canvas.toBlob(done);
  }

  function save(blob, name) {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // The buttons that save a chart.
  function buttons(u, title, name) {
    const made = Chart.element('span', { class: 'save' }, 'save as');
    const forms = {
      SVG: () => save(new Blob([svg(u, title())], { type: 'image/svg+xml' }), `${name}.svg`),
      PNG: () => png(u, title(), (blob) => save(blob, `${name}.png`)),
    };
    for (const [form, work] of Object.entries(forms)) {
      const button = Chart.element('button', { type: 'button', 'data-form': form }, form);
      button.addEventListener('click', work);
      made.append(button);
    }
    return made;
  }

  return { buttons, save, svg };
})();
