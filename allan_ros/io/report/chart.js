// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// What all charts share: colours of the theme, numbers, logarithmic axes, the cursor and its note.
'use strict';

const Chart = (() => {
  const all = [];
  const SUPERSCRIPT = { '-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹' };
  const FONT = '12px system-ui, sans-serif';

  // A colour of the page as it is now: light, dark or printed.
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

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

  function decade(value) {
    const exponent = Math.round(Math.log10(value));
    if (Math.abs(value / 10 ** exponent - 1) > 1e-6) return number(value, 1);
    return exponent >= -3 && exponent <= 4 ? String(Number((10 ** exponent).toPrecision(1))) : `10${power(exponent)}`;
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

  function axis(log, size, label) {
    return {
      ...(label ? { label, labelFont: FONT, labelSize: 22, labelGap: 2 } : {}),
      stroke: () => colour('ink-2'),
      grid: { stroke: () => colour('grid'), width: 1 },
      ticks: { stroke: () => colour('grid'), width: 1, size: 5 },
      font: FONT,
      size,
      ...(log ? { values: (u, splits) => splits.map((s) => (isRound(s) ? decade(s) : '')), space: 34 } : {}),
    };
  }

  // Whether a tick has one digit: uPlot's first is the end of the axis, wherever that lies.
  const isRound = (value) => value !== null && Math.abs(Number(value.toPrecision(1)) / value - 1) < 1e-6;

  // Make a chart that fills its host, follows the theme, and tells its numbers at the cursor.
  //   options.describe(u, index) returns the lines of the note: [text, colour or null] each.
  function create(host, options, data) {
    const height = options.height || 360;
    const box = element('div', { class: 'plot', tabindex: '0', role: 'group', 'aria-label': options.label });
    const tip = element('div', { class: 'tip', hidden: '' });
    const spoken = element('p', { class: 'spoken', 'aria-live': 'polite' });
    host.append(box);
    let leave = false;
    const u = new uPlot(
      {
        width: Math.max(280, host.clientWidth),
        height,
        padding: options.padding || [8, 14, 0, 0],
        legend: { show: false },
        scales: {
          x: { time: false, distr: options.x.log ? 3 : 1, range: options.x.range },
          y: { distr: options.y.log ? 3 : 1, range: options.y.range },
        },
        axes: [{ ...axis(options.x.log, 34, options.x.label), ...options.x.axis }, { ...axis(options.y.log, 58), ...options.y.axis }],
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

    function show(chart) {
      const at = chart.cursor.idx;
      if (leave || at === null || at === undefined || chart.cursor.left < 0) {
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

  // A row of buttons that are on or off.
  function toggles(label, names, change) {
    const group = element('div', { class: 'toggles', role: 'group', 'aria-label': label }, element('span', {}, label));
    for (const { key, text, style } of names) {
      const button = element('button', { type: 'button', 'aria-pressed': 'true', 'data-key': key }, text);
      if (style) button.style.setProperty('--chip', style);
      button.addEventListener('click', () => {
        const on = button.getAttribute('aria-pressed') !== 'true';
        button.setAttribute('aria-pressed', String(on));
        change(key, on);
      });
      group.append(button);
    }
    return group;
  }

  return { colour, create, element, number, redrawAll, toggles };
})();
