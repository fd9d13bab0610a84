// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// The Allan deviation of one sensor: curves with limits, the fit, and the parts of the curve that
// is nearest to the cursor. Colour is the axis, dashes and a letter are the term.
'use strict';

const AllanChart = (() => {
  const { colour, element, number } = Chart;
  const DASHES = { Q: [1, 3], N: [8, 3], B: [9, 3, 2, 3], K: [14, 4], R: [4, 3, 1, 3, 1, 3] };
  const BESIDE = [[2, 2], [6, 2], [1, 4]];
  const STRIP = 15;

  // A marker of an axis, so that axes differ in shape as well as in colour.
  function mark(context, label, x, y, size) {
    context.beginPath();
    if (label === 'x') context.arc(x, y, size, 0, 2 * Math.PI);
    else if (label === 'y') context.rect(x - 0.9 * size, y - 0.9 * size, 1.8 * size, 1.8 * size);
    else {
      context.moveTo(x, y - 1.2 * size);
      context.lineTo(x + 1.1 * size, y + 0.8 * size);
      context.lineTo(x - 1.1 * size, y + 0.8 * size);
      context.closePath();
    }
  }

  function create(host, sensor, units) {
    const axes = sensor.axes.filter((a) => a.adev);
    const shown = new Set([...axes.map((a) => a.label), 'fit', 'limits', 'Q', 'N', 'B', 'K', 'R', 'other', 'beside']);
    let system = units;
    let near = axes[0];
    let named = [];
    const unit = () => sensor.units[system].curve;
    const scaled = (values) => values.map((v) => (v === null ? null : v * unit()[1]));
    const columns = () => [sensor.tau, ...axes.flatMap((a) => [scaled(a.low), scaled(a.high), scaled(a.fit), scaled(a.adev)])];
    const visible = () => axes.filter((a) => shown.has(a.label));

    const series = axes.flatMap((a) => [
      { label: `${a.label} low`, width: 0, points: { show: false } },
      { label: `${a.label} high`, width: 0, points: { show: false } },
      { label: `${a.label} fit`, stroke: () => colour(a.label), width: 1.6, points: { show: false } },
      { label: a.label, paths: () => null, points: { show: false } },
    ]);
    const bands = axes.map((a, i) => ({ series: [4 * i + 2, 4 * i + 1], fill: () => colour(`${a.label}-faint`) }));

    function span(pick, low, high) {
      const values = (visible().length ? visible() : axes).flatMap(pick).filter((v) => v > 0);
      return values.length ? [low * Math.min(...values), high * Math.max(...values)] : [0.1, 10];
    }
    const rangeY = () => span((a) => scaled(a.adev), 0.45, 1.7);
    const rangeX = () => [sensor.tau[0] / 1.25, sensor.tau[sensor.tau.length - 1] * 1.35];

    function line(u, values, dash, width, ink) {
      const { ctx } = u;
      ctx.save();
      ctx.beginPath();
      ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      ctx.clip();
      ctx.beginPath();
      let open = false;
      values.forEach((v, i) => {
        if (!(v > 0)) { open = false; return; }
        const x = u.valToPos(sensor.tau[i], 'x', true);
        const y = u.valToPos(v * unit()[1], 'y', true);
        if (open) ctx.lineTo(x, y);
        else ctx.moveTo(x, y);
        open = true;
      });
      ctx.setLineDash(dash.map((d) => d * devicePixelRatio));
      ctx.lineWidth = width * devicePixelRatio;
      ctx.strokeStyle = ink;
      ctx.stroke();
      ctx.restore();
    }

    function text(u, words, x, y, ink, align = 'center') {
      const { ctx } = u;
      ctx.save();
      ctx.font = `600 ${12 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.textAlign = align;
      ctx.textBaseline = 'middle';
      ctx.lineWidth = 4 * devicePixelRatio;
      ctx.lineJoin = 'round';
      ctx.strokeStyle = colour('paper');
      ctx.strokeText(words, x, y);
      ctx.fillStyle = ink;
      ctx.fillText(words, x, y);
      ctx.restore();
    }

    // The letter of a part stands on its line where the line enters or leaves the picture.
    function letter(u, words, values, ink) {
      const inside = places(u, values);
      if (!inside.length) return;
      const rising = inside[0][1] > inside[inside.length - 1][1];
      const [x, y] = inside[rising ? 0 : inside.length - 1];
      text(u, words, Math.min(Math.max(x, u.bbox.left + 10), u.bbox.left + u.bbox.width - 10), y, ink);
    }

    // The name of a line of comparison stands beside it, where it is farthest from all curves.
    function name(u, words, values, ink) {
      const { ctx, bbox } = u;
      ctx.font = `600 ${12 * devicePixelRatio}px system-ui, sans-serif`;
      const half = ctx.measureText(words).width / 2 + 4 * devicePixelRatio;
      const lines = sensor.references.filter((r) => r.axis === near.name && r.adev !== values);
      const others = [...visible(), ...lines].flatMap((a) => places(u, a.adev)).concat(named);
      let best = [-Infinity];
      for (const [px, py] of places(u, values)) {
        const x = Math.min(Math.max(px, bbox.left + half), bbox.left + bbox.width - half);
        for (const y of [py - 14 * devicePixelRatio, py + 14 * devicePixelRatio]) {
          if (y < bbox.top + 10 || y > bbox.top + bbox.height - 10) continue;
          const near = others.filter(([ox]) => Math.abs(ox - x) < half + 10).map(([, oy]) => Math.abs(oy - y));
          // far enough is far enough: then the one that lies best on its own line
          const score = Math.min(40 * devicePixelRatio, ...near) - Math.abs(x - px);
          if (score > best[0]) best = [score, x, y];
        }
      }
      if (best[0] === -Infinity) return;
      named.push([best[1] - half, best[2]], [best[1], best[2]], [best[1] + half, best[2]]);
      text(u, words, best[1], best[2], ink);
    }

    // Where a line runs in the picture.
    const places = (u, values) => values
      .map((v, i) => [u.valToPos(sensor.tau[i], 'x', true), v > 0 ? u.valToPos(v * unit()[1], 'y', true) : NaN])
      .filter(([x, y]) => x >= u.bbox.left && x <= u.bbox.left + u.bbox.width && y > u.bbox.top + 8 && y < u.bbox.top + u.bbox.height - 8);

    function above(u) {
      const { ctx } = u;
      const ratio = devicePixelRatio;
      named = [];
      const beside = sensor.references.filter((r) => r.axis === near.name && shown.has('beside'));
      if (shown.has(near.label)) {
        beside.forEach((other, i) => line(u, other.adev, BESIDE[i % BESIDE.length], 1.4, colour('ink-2')));
        for (const [term, values] of Object.entries(near.parts)) {
          if (!shown.has(term in DASHES ? term : 'other')) continue;
          line(u, values, DASHES[term] || [2, 4], 1.2, colour(near.label));
          letter(u, term, values, colour(near.label));
        }
      }
      for (const a of visible()) {
        ctx.lineWidth = 1.3 * ratio;
        ctx.strokeStyle = colour(a.label);
        ctx.fillStyle = colour('paper');
        a.adev.forEach((v, i) => {
          if (!(v > 0)) return;
          const x = u.valToPos(sensor.tau[i], 'x', true);
          const y = u.valToPos(v * unit()[1], 'y', true);
          if (x < u.bbox.left || x > u.bbox.left + u.bbox.width || y < u.bbox.top || y > u.bbox.top + u.bbox.height) return;
          mark(ctx, a.label, x, y, 2.6 * ratio);
          ctx.fill();
          ctx.stroke();
        });
      }
      if (shown.has(near.label)) beside.forEach((other) => name(u, other.name, other.adev, colour('ink-2')));
      visible().forEach((a, row) => strip(u, a, row));
    }

    // Above the picture a strip for each axis: which term rules where.
    function strip(u, a, row) {
      const { ctx } = u;
      const ratio = devicePixelRatio;
      const top = u.bbox.top - (axes.length - row) * STRIP * ratio - 4 * ratio;
      const left = u.bbox.left;
      const right = left + u.bbox.width;
      ctx.save();
      text(u, a.label, left - 10 * ratio, top + STRIP * ratio / 2, colour(a.label), 'right');
      (a.regions || []).forEach(([low, high, term], i) => {
        const from = Math.max(left, u.valToPos(low, 'x', true));
        const to = Math.min(right, u.valToPos(high, 'x', true));
        if (to <= from) return;
        ctx.fillStyle = colour(`${a.label}-${i % 2 ? 'tint' : 'faint'}`);
        ctx.fillRect(from, top, to - from - ratio, (STRIP - 2) * ratio);
        ctx.font = `600 ${11 * ratio}px system-ui, sans-serif`;
        if (to - from < ctx.measureText(term).width + 4 * ratio) return;
        ctx.fillStyle = colour('ink');
        ctx.textAlign = 'center';
        ctx.textBaseline = 'middle';
        ctx.fillText(term, (from + to) / 2, top + (STRIP - 1) * ratio / 2);
      });
      ctx.restore();
    }

    // The axis whose curve is nearest to the cursor is the one whose parts are drawn.
    function focus(u, at) {
      let best = Infinity;
      let found = near;
      for (const a of visible()) {
        if (!(a.adev[at] > 0)) continue;
        const distance = Math.abs(u.valToPos(a.adev[at] * unit()[1], 'y') - u.cursor.top);
        if (distance < best) { best = distance; found = a; }
      }
      if (found !== near) {
        near = found;
        tell();
        u.redraw(false, false);
      }
    }

    function describe(u, at) {
      const [name, factor] = unit();
      const lines = [[`τ ${number(sensor.tau[at])} s`, null]];
      for (const a of visible()) {
        if (!(a.adev[at] > 0)) continue;
        lines.push([`${a.label}  ${number(a.adev[at] * factor)} ${name}  (${number(a.low[at] * factor, 3)}..${number(a.high[at] * factor, 3)})`, colour(a.label)]);
      }
      if (shown.has(near.label)) {
        const parts = Object.entries(near.parts)
          .filter(([term, values]) => shown.has(term in DASHES ? term : 'other') && values[at] > 0)
          .map(([term, values]) => `${term} ${number(values[at] * factor, 3)}`);
        if (parts.length) lines.push([`of ${near.label}: ${parts.join(', ')}`, null]);
        const region = (near.regions || []).find(([low, high]) => sensor.tau[at] >= low && sensor.tau[at] <= high);
        if (region) lines.push([`${region[2]} rules ${near.label} here, slope ${region[3] < 0 ? '−' : '+'}${Math.abs(region[3]).toFixed(2)}`, null]);
        if (near.n[at]) lines.push([`${near.n[at].toLocaleString('en')} differences`, null]);
      }
      return lines;
    }

    const heading = element('h3', {}, 'Allan deviation');
    const parts = element('span', { class: 'note' });
    const tell = () => {
      heading.textContent = `Allan deviation, ${unit()[0]}`;
      parts.textContent = `Parts drawn: those of ${near.label}, the curve nearest to the cursor.`;
    };
    const controls = element('div', { class: 'controls' });
    host.append(heading, controls);
    const u = Chart.create(host, {
      label: `Allan deviation of the ${sensor.sensor}; arrow keys move from point to point`,
      height: 462,
      padding: [axes.length * STRIP + 12, 14, 0, 0],
      zoomY: true,
      x: { log: true, range: rangeX, label: 'averaging time τ [s]' },
      y: { log: true, range: rangeY },
      series, bands, above, focus, describe,
    }, columns());

    function change(key, on) {
      if (on) shown.add(key);
      else shown.delete(key);
      axes.forEach((a, i) => {
        const there = shown.has(a.label);
        const limits = there && shown.has('limits');
        [limits, limits, there && shown.has('fit'), there].forEach((state, j) => u.setSeries(4 * i + 1 + j, { show: state }));
      });
      if (!shown.has(near.label) && visible().length) [near] = visible();
      tell();
      u.setData(columns());
    }
    const terms = [...new Set(axes.flatMap((a) => Object.keys(a.parts)))];
    const others = [['fit', 'fit'], ['limits', '68 % limits']];
    if (terms.some((t) => !(t in DASHES))) others.push(['other', 'other parts']);
    if (sensor.references.length) others.push(['beside', [...new Set(sensor.references.map((r) => r.name))].join(', ')]);
    controls.append(
      Chart.toggles('axes', axes.map((a) => ({ key: a.label, text: a.label, style: `var(--${a.label})` })), change),
      Chart.toggles('parts', Object.keys(DASHES).filter((t) => terms.includes(t)).map((t) => ({ key: t, text: t })), change),
      Chart.toggles('also', others.map(([key, text]) => ({ key, text })), change),
    );
    host.append(element('p', { class: 'note' },
      'The strips on top say which term rules where. Drag to zoom, double-click to go back. ', parts));
    tell();
    return { units(next) { system = next; tell(); u.setData(columns()); } };
  }

  return { create };
})();
