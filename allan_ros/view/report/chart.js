// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Draws a chart as SVG, with axes, zoom, numbers at the cursor, and saving to files. The colors are CSS
// variables.
'use strict';

const Chart = (() => {
  const all = [];
  const SUPERSCRIPT = { '-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹' };
  const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';
  const LABEL_ROOM = { x: 46, y: 24 };  // pixels that a label occupies along its axis
  const [LEFT, RIGHT, ABOVE, BELOW] = [52, 10, 24, 40];  // margins of the plot in pixels
  const HEAD = 26;  // height of the title of a saved chart

  const power = (exponent) => [...String(exponent)].map((c) => SUPERSCRIPT[c]).join('');
  const escape = (text) => String(text).replace(/[&<>"]/g, (c) => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' })[c]);
  const clean = (value) => Number(value.toPrecision(12));
  const px = (v) => String(Math.round(v * 10) / 10);

  // Return a number as text with `digits` significant digits. Very small and very large numbers are
  // written with a power of ten.
  function number(value, digits = 4) {
    if (value === null || value === undefined || !Number.isFinite(value)) return '–';
    if (value === 0) return '0';
    const exponent = Math.floor(Math.log10(Math.abs(value)));
    if (exponent >= -3 && exponent <= 5) return Number(value.toPrecision(digits)).toFixed(Math.max(0, digits - 1 - exponent));
    return `${(value / 10 ** exponent).toFixed(digits - 1)}·10${power(exponent)}`;
  }

  // Return the label of a tick, which is as short as the value allows.
  function tick(value) {
    const size = Math.abs(value);
    if (value === 0 || (size >= 1e-3 && size < 1e5)) return String(clean(value)).replace('-', '−');
    const exponent = Math.floor(Math.log10(size) + 1e-9);
    const lead = Number((value / 10 ** exponent).toPrecision(4));
    return lead === 1 ? `10${power(exponent)}` : `${lead}·10${power(exponent)}`.replace('-', '−');
  }

  // Return round values for a logarithmic axis: each of `digits` times every power of ten, or every
  // `step`-th power.
  function round(min, max, digits, step = 1) {
    const values = [];
    for (let e = Math.floor(Math.log10(min) / step) * step; 10 ** e <= max; e += step) {
      for (const digit of digits) values.push(clean(digit * 10 ** e));
    }
    return values.filter((v) => v >= min * (1 - 1e-9) && v <= max * (1 + 1e-9));
  }

  // Return about `count` evenly spaced round values between `min` and `max`.
  function even(min, max, count) {
    const unit = 10 ** Math.floor(Math.log10((max - min) / count));
    const step = unit * [1, 2, 5, 10].find((s) => s * unit * count >= (max - min) * (1 - 1e-9));
    const values = [];
    for (let v = Math.ceil(min / step) * step; v <= max + 1e-9 * step; v += step) values.push(clean(v));
    return values;
  }

  // Return at least three values that are labeled on an axis, with enough room for each label if
  // possible. `pixels` is the length of the axis, and `room` the length that a label occupies.
  function labeled(log, min, max, pixels, room) {
    const at = (v) => (log ? (Math.log10(v) * pixels) / Math.log10(max / min) : (v * pixels) / (max - min));
    const fits = (values) => values.length >= 3 && values.every((v, i) => i === 0 || at(v) - at(values[i - 1]) >= room);
    const decades = log ? [[[1, 2, 5]], [[1, 3]], [[1]], [[1], 2], [[1], 3], [[1], 5]].map((how) => round(min, max, ...how)) : [];
    const fewValues = [8, 7, 6, 5, 4, 3, 2].map((count) => even(min, max, count));
    const manyValues = [3, 4, 5, 6, 8, 10].map((count) => even(min, max, count));
    return [...decades, ...fewValues].find(fits) || manyValues.find((values) => values.length >= 3);
  }

  // Create an HTML element with children. A child that is a text is never parsed as HTML.
  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }

  // Return the markup with each CSS variable replaced by its color in the light theme, for files.
  function onPaper(markup) {
    const root = document.documentElement.classList;
    const wasPrinting = root.contains('printing');
    root.add('printing');
    const style = getComputedStyle(document.documentElement);
    const light = markup.replace(/var\(--([\w-]+)\)/g, (_, name) => style.getPropertyValue(`--${name}`).trim());
    if (!wasPrinting) root.remove('printing');
    return light;
  }

  // A pen draws lines, areas, markers and labels into a chart. Values outside the plot are clipped.
  class Pen {
    constructor(box, x, y, id) {
      Object.assign(this, { box, x, y, id, parts: [], occupied: [] });
      this.ruler = Pen.ruler || (Pen.ruler = element('canvas').getContext('2d'));
      this.ruler.font = `600 12px ${FONT}`;
    }
    inside(x, y) {
      const { left, top, width, height } = this.box;
      return x >= left && x <= left + width && y >= top && y <= top + height;
    }
    path(xs, ys) {
      let d = '';
      let isConnected = false;
      xs.forEach((v, i) => {
        const y = ys[i] === null || ys[i] === undefined ? NaN : this.y(ys[i]);
        if (Number.isFinite(y)) d += `${isConnected ? 'L' : 'M'}${px(this.x(v))} ${px(y)}`;
        isConnected = Number.isFinite(y);
      });
      return d;
    }
    line(xs, ys, { color, width = 1.5, dash = '' }) {
      this.parts.push(`<path d="${this.path(xs, ys)}" fill="none" stroke="${color}" stroke-width="${width}" stroke-linejoin="round"${dash ? ` stroke-dasharray="${dash}"` : ''}/>`);
    }
    // Draw the area between two lines. Missing values split the area into pieces.
    area(xs, low, high, color) {
      let piece = [];
      const close = () => {
        if (piece.length) {
          const up = piece.map((i) => `${px(this.x(xs[i]))} ${px(this.y(high[i]))}`);
          const down = piece.map((i) => `${px(this.x(xs[i]))} ${px(this.y(low[i]))}`).reverse();
          this.parts.push(`<path d="M${[...up, ...down].join('L')}Z" fill="${color}" stroke="${color}" stroke-opacity=".5" stroke-width=".5"/>`);
        }
        piece = [];
      };
      xs.forEach((_, i) => (low[i] !== null && high[i] !== null && Number.isFinite(this.y(low[i])) ? piece.push(i) : close()));
      close();
    }
    // Draw a marker at each point. The shape of the marker shows the axis, as its color does.
    marks(xs, ys, label, color, size = 2.6, fill = 'var(--paper)') {
      let d = '';
      xs.forEach((v, i) => {
        if (ys[i] === null || ys[i] === undefined) return;
        const [x, y] = [this.x(v), this.y(ys[i])];
        if (!this.inside(x, y)) return;
        if (label === 'x') d += `M${px(x - size)} ${px(y)}a${size} ${size} 0 1 0 ${2 * size} 0a${size} ${size} 0 1 0 ${-2 * size} 0Z`;
        else if (label === 'y') d += `M${px(x - 0.9 * size)} ${px(y - 0.9 * size)}h${1.8 * size}v${1.8 * size}h${-1.8 * size}Z`;
        else d += `M${px(x)} ${px(y - 1.2 * size)}l${1.1 * size} ${2 * size}h${-2.2 * size}Z`;
      });
      this.parts.push(`<path d="${d}" fill="${fill}" stroke="${color}" stroke-width="1.3"/>`);
    }
    cross(x, y, color) {
      this.parts.push(`<path d="M${px(x - 6)} ${px(y)}h12M${px(x)} ${px(y - 6)}v12" stroke="${color}" stroke-width="2"/>`);
    }
    // Draw a vertical stripe between two values of x, at least two pixels wide.
    stripe(from, to, fill, hatch = '') {
      const { left, top, width, height } = this.box;
      const start = Math.max(left, this.x(from));
      const wide = Math.max(2, Math.min(left + width, this.x(to)) - start);
      if (start > left + width || this.x(to) < left) return;
      if (hatch) this.parts.push(`<pattern id="${this.id}-${hatch}" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(${hatch === 'up' ? 45 : -45})"><path d="M0 0v7" stroke="${fill}" stroke-width="1.6"/></pattern>`);
      const veil = hatch ? `<rect x="${px(start)}" y="${top}" width="${px(wide)}" height="${height}" fill="var(--paper)" opacity=".75"/>` : '';
      this.parts.push(`${veil}<rect x="${px(start)}" y="${top}" width="${px(wide)}" height="${height}" fill="${hatch ? `url(#${this.id}-${hatch})` : fill}"/>`);
    }
    // Draw a vertical line. An optional text is placed near its top, where no other text is.
    rule(v, color, words = '', dash = '') {
      const x = this.x(v);
      if (!this.inside(x, this.box.top)) return;
      this.parts.push(`<path d="M${px(x)} ${this.box.top}v${this.box.height}" stroke="${color}"${dash ? ` stroke-dasharray="${dash}"` : ''}/>`);
      if (words) this.label(words, [0, 1, 2, 3].map((row) => [x, this.box.top + 9 + 15 * row]), color);
    }
    // Draw a text at the first free place of `places`, which are (x, y) in pixels.
    label(words, places, color) {
      const { left, top, width, height } = this.box;
      const wide = this.ruler.measureText(words).width;
      for (const [px0, y] of places) {
        const x = Math.min(Math.max(px0, left + wide / 2 + 3), left + width - wide / 2 - 3);
        if (y < top + 8 || y > top + height - 8) continue;
        if (this.occupied.some(([ox, oy, ow]) => Math.abs(ox - x) < (ow + wide) / 2 + 4 && Math.abs(oy - y) < 15)) continue;
        this.occupied.push([x, y, wide]);
        this.parts.push(`<text x="${px(x)}" y="${px(y)}" font-weight="600" text-anchor="middle" dominant-baseline="central" fill="${color}" stroke="var(--paper)" stroke-width="4" paint-order="stroke">${escape(words)}</text>`);
        return;
      }
    }
  }

  // Create a chart that fills its host and shows its numbers at the cursor.
  //   title, name: title of the chart, and file name without ending; height: height in pixels
  //   zoomY: whether a range of y can be selected together with a range of x
  //   x, y: {log, label(), full()}; log: whether the axis is logarithmic; full(): complete range
  //   xs: values of x at which the cursor stops; legend(): letters of the axes that are drawn
  //   draw(pen): draws the content
  //   describe(index): lines of text at the cursor, each as [text, color or '']
  //   focus(index, y): called when the cursor moves; returns whether the chart must be drawn again
  function create(host, spec) {
    const box = element('div', { class: 'plot', tabindex: '0', role: 'group', 'aria-label': `${spec.title}; arrow keys move from point to point` });
    const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    const tip = element('div', { class: 'tip', hidden: '' });
    const spoken = element('p', { class: 'spoken', 'aria-live': 'polite' });
    box.append(svg, tip, spoken);
    host.append(box);
    const chart = { box, spec, labels: {}, zoom: null, at: null, id: `c${all.length}`, render, save, svg: markup };
    let plot = null;  // sizes and scales of the latest drawing

    function scale(which, from, to) {
      const { log, full } = spec[which];
      const [min, max] = (chart.zoom && chart.zoom[which]) || full();
      const [a, b] = log ? [Math.log(min), Math.log(max)] : [min, max];
      const forward = (v) => from + ((log ? Math.log(v) : v) - a) / (b - a) * (to - from);
      const back = (p) => { const v = a + (p - from) / (to - from) * (b - a); return log ? Math.exp(v) : v; };
      return { min, max, log, forward, back };
    }

    function render(width = host.clientWidth, height = spec.height) {
      if (!width) return;  // the chart is in a closed section of the page
      const area = { left: LEFT, top: ABOVE, width: width - LEFT - RIGHT, height: height - ABOVE - BELOW };
      const x = scale('x', area.left, area.left + area.width);
      const y = scale('y', area.top + area.height, area.top);
      plot = { width, height, area, x, y };
      const pen = new Pen(area, x.forward, y.forward, chart.id);
      spec.draw(pen);
      const grid = [...lines('x', x, area.width), ...lines('y', y, area.height)];
      const clip = `<clipPath id="${chart.id}"><rect x="${area.left}" y="${area.top}" width="${area.width}" height="${area.height}"/></clipPath>`;
      svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
      svg.setAttribute('font-size', '12');
      const legend = spec.legend ? spec.legend().map((name) => `<tspan dx="10" fill="var(--${name})">${name}</tspan>`) : [];
      svg.innerHTML = `${clip}${grid.join('')}<text x="2" y="13" fill="var(--ink-2)">${escape(spec.y.label())}</text>`
        + `<text x="${area.left + area.width / 2}" y="${height - 5}" text-anchor="middle" fill="var(--ink-2)">${escape(spec.x.label())}</text>`
        + `<text x="${area.left + area.width}" y="14" text-anchor="end" font-weight="600">${legend.join('')}</text>`
        + `<g clip-path="url(#${chart.id})">${pen.parts.join('')}</g><path class="cursor" stroke="var(--ink-2)" stroke-dasharray="3 3"/><rect class="drag" fill="var(--ink-2)" opacity=".25" width="0"/>`;
    }

    // Return the grid lines and labels of an axis. A logarithmic axis has a grid line for every digit.
    function lines(which, { min, max, log, forward }, pixels) {
      const { left, top, width, height } = plot.area;
      const values = labeled(log, min, max, pixels, LABEL_ROOM[which]);
      chart.labels[which] = values.map((v) => [v, tick(v)]);
      const digitValues = log ? round(min, max, Math.log10(max / min) > 7 ? [1] : [1, 2, 3, 4, 5, 6, 7, 8, 9]) : [];
      const line = (v) => (which === 'x' ? `M${px(forward(v))} ${top}v${height}` : `M${left} ${px(forward(v))}h${width}`);
      const words = chart.labels[which].map(([v, text]) => (which === 'x'
        ? `<text x="${px(forward(v))}" y="${top + height + 16}" text-anchor="middle" fill="var(--ink-2)">${text}</text>`
        : `<text x="${left - 6}" y="${px(forward(v))}" text-anchor="end" dominant-baseline="central" fill="var(--ink-2)">${text}</text>`));
      return [`<path d="${[...new Set([...digitValues, ...values])].map(line).join('')}" stroke="var(--grid)"/>`, ...words];
    }

    // Return the chart as an SVG file with its title, in the colors of the light theme.
    function markup() {
      if (!plot) render(640);
      const { width, height } = plot;
      return onPaper(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 ${-HEAD} ${width} ${height + HEAD}" width="${width}" height="${height + HEAD}" font-size="12" font-family="${escape(FONT)}">`
        + `<rect y="${-HEAD}" width="100%" height="100%" fill="var(--paper)"/><text x="2" y="-8" font-size="14" font-weight="600" fill="var(--ink)">${escape(spec.title)}</text>${svg.innerHTML}</svg>\n`);
    }

    async function save(form) {
      if (form === 'SVG') return download(new Blob([markup()], { type: 'image/svg+xml' }), `${spec.name}.svg`);
      const image = new Image();
      image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(markup())}`;
      await image.decode();
      const canvas = element('canvas');  // three times the resolution of the screen, for printing
      [canvas.width, canvas.height] = [3 * image.width, 3 * image.height];
      canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
      return canvas.toBlob((blob) => download(blob, `${spec.name}.png`));
    }

    function show(at, y = null) {
      chart.at = at;
      tip.hidden = at === null;
      const cursor = svg.querySelector('.cursor');
      if (at === null) return cursor.removeAttribute('d');
      if (spec.focus && spec.focus(at, y === null ? null : plot.y.back(y))) render();
      const x = plot.x.forward(spec.xs[at]);
      svg.querySelector('.cursor').setAttribute('d', `M${px(x)} ${plot.area.top}v${plot.area.height}`);
      tip.replaceChildren(...spec.describe(at).map(([text, color]) => element('div', color ? { style: `color: ${color}` } : {}, text)));
      const zoomed = svg.clientWidth / plot.width;
      const left = x * zoomed > box.clientWidth / 2 ? x * zoomed - 12 - tip.offsetWidth : x * zoomed + 12;
      tip.style.left = `${Math.max(0, Math.min(left, box.clientWidth - tip.offsetWidth))}px`;
      tip.style.top = `${ABOVE + 4}px`;
      return undefined;
    }

    const place = (event) => {
      const rect = svg.getBoundingClientRect();
      return [(event.clientX - rect.left) * plot.width / rect.width, (event.clientY - rect.top) * plot.width / rect.width];
    };
    const nearest = (value) => {
      const distances = spec.xs.map((v) => (v === null ? Infinity : Math.abs(plot.x.forward(v) - value)));
      return distances.indexOf(Math.min(...distances));
    };
    let start = null;
    svg.addEventListener('pointermove', (event) => {
      const [x, y] = place(event);
      show(nearest(x), y);
      if (!start) return;
      const drag = svg.querySelector('.drag');
      const selectsY = spec.zoomY && Math.abs(y - start[1]) > 24;
      const { top, height } = plot.area;
      for (const [name, value] of Object.entries({ x: Math.min(x, start[0]), width: Math.abs(x - start[0]), y: selectsY ? Math.min(y, start[1]) : top, height: selectsY ? Math.abs(y - start[1]) : height })) drag.setAttribute(name, value);
    });
    svg.addEventListener('pointerdown', (event) => {
      if (event.pointerType !== 'mouse') return show(nearest(place(event)[0]), place(event)[1]);
      event.preventDefault();
      box.focus({ preventScroll: true });
      svg.setPointerCapture(event.pointerId);
      start = place(event);
      return undefined;
    });
    svg.addEventListener('pointerup', (event) => {
      const [from, to] = [start, place(event)];
      start = null;
      if (!from || Math.abs(to[0] - from[0]) < 8) return render();
      const range = (which, i) => [from[i], to[i]].map(plot[which].back).sort((a, b) => a - b);
      const selectsY = spec.zoomY && Math.abs(to[1] - from[1]) > 24;
      chart.zoom = { x: range('x', 0), y: selectsY ? range('y', 1) : null };
      return render();
    });
    // Divide the shown range of x by `factor`. The center is the cursor, or the middle without a cursor.
    chart.zoomBy = (factor) => {
      const { x, area } = plot;
      const [left, right] = [area.left, area.left + area.width];
      const center = chart.at === null ? (left + right) / 2 : x.forward(spec.xs[chart.at]);
      const ends = [left, right].map((end) => center + (end - center) / factor);
      const fullRange = spec.x.full();
      const [first, last] = fullRange.map(x.forward);
      const range = [ends[0] > first ? x.back(ends[0]) : fullRange[0], ends[1] < last ? x.back(ends[1]) : fullRange[1]];
      const isWhole = ends[0] < first + 1 && ends[1] > last - 1;  // with a tolerance of one pixel
      chart.zoom = isWhole ? null : { x: range, y: chart.zoom && chart.zoom.y };
      render();
    };
    svg.addEventListener('dblclick', () => { chart.zoom = null; render(); });
    svg.addEventListener('pointerleave', () => show(null));
    box.addEventListener('blur', () => show(null));
    box.addEventListener('keydown', (event) => {
      const here = chart.at === null ? -1 : chart.at;
      const steps = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: spec.xs.length - 1 };
      if (event.key === 'Escape') show(null);
      if (!(event.key in steps)) return;
      event.preventDefault();
      show(Math.max(0, Math.min(spec.xs.length - 1, steps[event.key])));
      spoken.textContent = spec.describe(chart.at).map(([text]) => text).join(', ');
    });
    new ResizeObserver(() => { if (!document.documentElement.classList.contains('printing') && host.clientWidth && (!plot || Math.abs(host.clientWidth - plot.width) > 1)) render(); }).observe(host);
    render();
    all.push(chart);
    return chart;
  }

  function download(blob, name) {
    const link = element('a', { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // Return buttons that zoom and save a chart.
  function saving(chart) {
    const zooms = [['+', 2, 'zoom in'], ['−', 0.5, 'zoom out']].map(([text, factor, title]) => {
      const button = element('button', { type: 'button', title, 'aria-label': title, 'data-zoom': String(factor) }, text);
      button.addEventListener('click', () => chart.zoomBy(factor));
      return button;
    });
    const buttons = ['SVG', 'PNG'].map((form) => {
      const button = element('button', { type: 'button', 'data-form': form }, form);
      button.addEventListener('click', () => chart.save(form));
      return button;
    });
    return element('span', { class: 'save' }, 'zoom', ...zooms, 'save', ...buttons);
  }

  // Return buttons that show or hide parts of a chart. A short line in each button shows how its part is
  // drawn.
  function toggles(names, change) {
    return names.map(({ key, text, color = 'var(--ink-2)', dash = '' }) => {
      const button = element('button', { type: 'button', class: 'toggle', 'aria-pressed': 'true', 'data-key': key, title: 'show or hide', style: `--chip: ${color}` });
      button.innerHTML = `<svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke-dasharray="${dash}"/></svg>`;
      button.append(text);
      button.addEventListener('click', () => {
        const isOn = button.getAttribute('aria-pressed') !== 'true';
        button.setAttribute('aria-pressed', String(isOn));
        change(key, isOn);
      });
      return button;
    });
  }

  return { all, create, element, number, saving, toggles };
})();
