// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Common parts of all charts: colors of the theme, numbers, logarithmic axes, zoom, cursor and its note.
'use strict';

const Chart = (() => {
  const all = [];
  const SUPERSCRIPT = { '-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹' };
  const FONT = '12px system-ui, sans-serif';
  const LABEL_ROOM = { x: 46, y: 26 };  // pixels that a label of a logarithmic axis takes along it

  // A color of the current theme of the page: light, dark or printed.
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  // Four significant digits, with a power of ten where zeros would hide them.
  function number(value, digits = 4) {
    if (value === null || value === undefined || !Number.isFinite(value)) return '–';
    if (value === 0) return '0';
    const exponent = Math.floor(Math.log10(Math.abs(value)));
    if (exponent >= -3 && exponent <= 5) {
      const decimals = Math.max(0, digits - 1 - exponent);
      return Number(value.toPrecision(digits)).toFixed(decimals);
    }
    return `${(value / 10 ** exponent).toFixed(digits - 1)}·10${power(exponent)}`;
  }

  const power = (exponent) => [...String(exponent)].map((c) => SUPERSCRIPT[c]).join('');

  // The label of a tick: as short as the value allows.
  function tick(value) {
    const size = Math.abs(value);
    if (value === 0 || (size >= 1e-3 && size < 1e5)) return String(Number(value.toPrecision(6)));
    const exponent = Math.floor(Math.log10(size) + 1e-9);
    const lead = Number((value / 10 ** exponent).toPrecision(4));
    return lead === 1 ? `10${power(exponent)}` : `${lead}·10${power(exponent)}`;
  }

  const clean = (value) => Number(value.toPrecision(12));

  // Round values of a logarithmic range: digits times every power of ten.
  function round(min, max, digits, step = 1) {
    const values = [];
    for (let e = Math.floor(Math.log10(min) / step) * step; 10 ** e <= max; e += step) {
      for (const digit of digits) values.push(clean(digit * 10 ** e));
    }
    return values.filter((v) => v >= min * (1 - 1e-9) && v <= max * (1 + 1e-9));
  }

  // Evenly spaced round values, for a range too narrow for decades.
  function even(min, max, count) {
    const raw = (max - min) / count;
    const unit = 10 ** Math.floor(Math.log10(raw));
    const step = unit * [1, 2, 5, 10].find((s) => s * unit >= raw);
    const values = [];
    for (let v = Math.ceil(min / step) * step; v <= max * (1 + 1e-9); v += step) values.push(clean(v));
    return values;
  }

  // The labeled values of a logarithmic axis with a given length in pixels: at least three if they fit.
  function labeled(min, max, pixels, room) {
    const log = (v) => (Math.log10(v) * pixels) / Math.log10(max / min);
    const fits = (values) => values.every((v, i) => i === 0 || log(v) - log(values[i - 1]) >= room);
    const choices = [
      round(min, max, [1, 2, 5]), round(min, max, [1, 3]), round(min, max, [1]),
      round(min, max, [1], 2), round(min, max, [1], 3), round(min, max, [1], 5),
    ];
    const good = choices.find((values) => values.length >= 3 && fits(values));
    if (good) return good;
    for (let count = 8; count >= 2; count -= 1) {
      const values = even(min, max, count);
      if (values.length >= 3 && fits(values)) return values;
    }
    return even(min, max, 3);
  }

  // Grid lines of a logarithmic axis: every digit of every decade, and all labeled values.
  function splits(min, max, labels) {
    const fine = Math.log10(max / min) > 7 ? round(min, max, [1]) : round(min, max, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    return [...new Set([...fine, ...labels])].sort((a, b) => a - b);
  }

  // An element with text and children; text is never read as HTML.
  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name === 'class') made.className = value;
      else made.setAttribute(name, value);
    }
    made.append(...children);
    return made;
  }

  function axis(which, log, size, label) {
    let labels = [];
    return {
      ...(label ? { label, labelFont: FONT, labelSize: 22, labelGap: 2 } : {}),
      stroke: () => color('ink-2'),
      grid: { stroke: () => color('grid'), width: 1 },
      ticks: { stroke: () => color('grid'), width: 1, size: 5 },
      font: FONT,
      size,
      ...(log ? {
        filter: (u, values) => values,
        splits(u, index, min, max) {
          const pixels = (which === 'x' ? u.bbox.width : u.bbox.height) / devicePixelRatio;
          labels = labeled(min, max, pixels || 300, LABEL_ROOM[which]);
          return splits(min, max, labels);
        },
        values: (u, values) => values.map((v) => (labels.includes(v) ? tick(v) : '')),
      } : {
        splits(u, index, min, max) {
          const pixels = (which === 'x' ? u.bbox.width : u.bbox.height) / devicePixelRatio;
          let values = [];
          for (let count = Math.max(2, Math.floor(pixels / (which === 'x' ? 70 : 30))); values.length < 3 && count < 20; count += 1) values = even(min, max, count);
          return values;
        },
        values: (u, values) => values.map(tick),
      }),
    };
  }

  // Create a chart that fills its host, follows the theme, and shows its numbers at the cursor.
  //   options.describe(u, index) returns the lines of the note: [text, color or null] each.
  //   options.x.full and options.y.full return the complete range.
  function create(host, options, data) {
    const height = options.height || 360;
    const box = element('div', { class: 'plot', tabindex: '0', role: 'group', 'aria-label': options.label });
    const tip = element('div', { class: 'tip', hidden: '' });
    const spoken = element('p', { class: 'spoken', 'aria-live': 'polite' });
    host.append(box);
    let zoomed = false;
    const rangeX = (chart, min, max) => {
      const times = chart.data[0];
      zoomed = min > times[0] || max < times[times.length - 1];
      return zoomed ? [min, max] : (options.x.full ? options.x.full() : [min, max]);
    };
    const rangeY = (chart, min, max) => {
      if (!zoomed || min === null || !(max > min)) return options.y.full();
      return options.y.log ? [min / 1.2, max * 1.2] : [min, max];
    };
    const u = new uPlot(
      {
        width: Math.max(280, host.clientWidth),
        height,
        padding: options.padding || [8, 14, 0, 0],
        legend: { show: false },
        scales: {
          x: { time: false, distr: options.x.log ? 3 : 1, range: rangeX },
          y: { distr: options.y.log ? 3 : 1, range: rangeY },
        },
        axes: [
          { ...axis('x', options.x.log, 34, options.x.label), ...options.x.axis },
          { ...axis('y', options.y.log, options.y.log ? 62 : 58, options.y.label), ...options.y.axis },
        ],
        series: [{}, ...options.series],
        bands: options.bands || [],
        cursor: {
          y: false,
          drag: { x: true, y: Boolean(options.zoomY), uni: 24 },
          points: { show: false },
          sync: options.sync ? { key: options.sync } : undefined,
        },
        hooks: {
          draw: options.above ? [options.above] : [],
          setCursor: [show],
        },
      },
      data,
      box,
    );
    u.over.append(tip);
    box.append(spoken);
    u.above = options.above;
    u.caption = options.label;

    function show(chart) {
      const at = chart.cursor.idx;
      if (at === null || at === undefined || chart.cursor.left < 0) {
        tip.hidden = true;
        return;
      }
      if (options.focus) options.focus(chart, at);
      const lines = options.describe(chart, at);
      tip.replaceChildren(...lines.map(([text, ink]) => {
        const line = element('div', {}, text);
        if (ink) line.style.color = ink;
        return line;
      }));
      tip.hidden = false;
      const x = chart.valToPos(chart.data[0][at], 'x');
      const wide = tip.offsetWidth;
      const room = chart.over.clientWidth;
      const left = x + 14 + wide > room ? x - 14 - wide : x + 14;
      tip.style.left = `${Math.max(-40, Math.min(left, room - wide))}px`;
      tip.style.top = `${higher(chart, at) ? 4 : chart.over.clientHeight - tip.offsetHeight - 4}px`;
    }

    // Whether there is more room above the curves at the cursor than below them.
    function higher(chart, at) {
      const there = chart.data.slice(1).map((values) => values[at]).filter((v) => v !== null && v !== undefined);
      const places = there.map((v) => chart.valToPos(v, 'y'));
      return !places.length || Math.min(...places) > chart.over.clientHeight - Math.max(...places);
    }

    function move(to) {
      const index = Math.max(0, Math.min(u.data[0].length - 1, to));
      u.setCursor({ left: u.valToPos(u.data[0][index], 'x'), top: u.over.clientHeight / 3 });
      spoken.textContent = options.describe(u, index).map(([text]) => text).join(', ');
    }

    box.addEventListener('keydown', (event) => {
      const at = u.cursor.idx;
      const here = at === null || at === undefined ? -1 : at;
      const steps = { ArrowRight: here + 1, ArrowLeft: here - 1, Home: 0, End: u.data[0].length - 1 };
      if (event.key === 'Escape') u.setCursor({ left: -10, top: -10 });
      if (!(event.key in steps)) return;
      event.preventDefault();
      move(steps[event.key]);
    });
    box.addEventListener('blur', () => u.setCursor({ left: -10, top: -10 }));
    // A finger drags the cursor sideways; up and down still scrolls the page.
    for (const kind of ['pointerdown', 'pointermove']) {
      u.over.addEventListener(kind, (event) => {
        if (event.pointerType === 'mouse') return;
        const rect = u.over.getBoundingClientRect();
        u.setCursor({ left: event.clientX - rect.left, top: event.clientY - rect.top });
      });
    }
    new ResizeObserver(() => {
      const width = Math.max(280, host.clientWidth);
      if (Math.abs(width - u.width) > 1) u.setSize({ width, height });
    }).observe(host);
    all.push(u);
    return u;
  }

  function redrawAll() {
    for (const u of all) u.redraw(false, true);
  }
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redrawAll);

  // A row of buttons that are on or off; a sample shows how each is drawn while it is on.
  function toggles(label, names, change) {
    const group = element('div', { class: 'toggles', role: 'group', 'aria-label': label }, element('span', {}, label));
    for (const { key, text, style, dash } of names) {
      const button = element('button', { type: 'button', 'aria-pressed': 'true', 'data-key': key, title: 'show or hide' });
      if (style) button.style.setProperty('--chip', style);
      button.append(sample(dash || []), text);
      button.addEventListener('click', () => {
        const on = button.getAttribute('aria-pressed') !== 'true';
        button.setAttribute('aria-pressed', String(on));
        change(key, on);
      });
      group.append(button);
    }
    return group;
  }

  function sample(dash) {
    const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
    const line = document.createElementNS('http://www.w3.org/2000/svg', 'line');
    for (const [name, value] of Object.entries({ viewBox: '0 0 20 8', 'aria-hidden': 'true' })) svg.setAttribute(name, value);
    for (const [name, value] of Object.entries({ x1: 0, x2: 20, y1: 4, y2: 4, 'stroke-dasharray': dash.join(' ') })) line.setAttribute(name, value);
    svg.append(line);
    return svg;
  }

  return { all, color, create, element, labeled, number, redrawAll, toggles };
})();
