// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// The charts of the report: Allan deviation, noise density, bias and noise over time, raw signal,
// temperature, and error in motion. The color of a line shows the axis; its dashes and a letter show the
// term. Each function of `Charts` draws the charts of one kind into an HTML element, and returns them.
'use strict';

const Charts = (() => {
  const { create, element, number, saving, toggles } = Chart;
  const DASHES = { Q: '1 3', N: '8 3', B: '9 3 2 3', K: '14 4', R: '4 3 1 3 1 3' };
  const [PROCESS, LIMIT, REFERENCE] = ['5 2', '1 5', '6 2'];
  const LINES = 9;  // largest number of frequencies that are labeled
  const ink = (label) => `var(--${label})`;
  const letter = (name) => name.split('_').pop();
  const times = (values, factor) => values.map((v) => (v === null ? null : v * factor));
  const positive = (lists) => lists.flat().filter((v) => v > 0);
  const span = (low, high) => `${number(low, 3)}..${number(high, 3)}`;

  // Append a row of buttons below a chart, which show or hide axes and other parts, zoom, and save.
  function below(host, chart, axes, shownKeys, others = [], changed = () => {}) {
    const names = [...axes.map((a) => ({ key: letter(a.name), text: letter(a.name), color: ink(letter(a.name)) })), ...others];
    const buttons = toggles(names, (key, isOn) => {
      if (isOn) shownKeys.add(key);
      else shownKeys.delete(key);
      changed();
      chart.render();
    });
    names.forEach(({ key }) => shownKeys.add(key));
    host.append(element('div', { class: 'controls' }, ...buttons, element('span', { class: 'grow' }), saving(chart)));
  }

  function allan(host, sensor, page) {
    const axes = sensor.axes.filter((a) => positive([a.adev || []]).length);
    if (!axes.length) return [];
    const { tau } = sensor;
    const shownKeys = new Set();
    let nearAxis = axes[0];
    const unit = () => sensor.units[page.units()].curve;
    const visible = () => axes.filter((a) => shownKeys.has(a.label));
    const questionMark = (term) => (nearAxis.unresolved.includes(term) ? '?' : '');
    // The flat part of the curve is at 0.664 B, and is labeled so, because the table contains B itself.
    const caption = (term) => (term === 'B' ? '0.664 B' : term) + questionMark(term);

    function fullY() {
      const shownAxes = visible().length ? visible() : axes;
      const factor = unit()[1];
      const values = positive(shownAxes.map((a) => times(a.adev, factor)));
      // a point from two or three differences may be far below the model, but must not set the scale
      const low = Math.min(...positive(shownAxes.map((a) => a.adev.map((v, i) => (v > 0 ? factor * Math.max(v, 0.1 * a.fit[i]) : 0)))));
      const marks = shownAxes.flatMap((a) => Object.values(a.read).map(([, v]) => v * factor)).filter((v) => v > 0.2 * low);
      return [Math.min(0.45 * low, ...marks.map((v) => 0.75 * v)), 1.7 * Math.max(...values)];
    }

    // Return the points of a line that are within the plot, (x, y) in pixels.
    const within = (pen, values) => values
      .map((v, i) => [pen.x(tau[i]), v > 0 ? pen.y(v) : NaN])
      .filter(([x, y]) => pen.inside(x, y - 8) && pen.inside(x, y + 8));

    // Label the line of a term. If the point at which the coefficient is read (IEEE Std 952: N at 1 s,
    // K at 3 s) is within the plot, a cross marks this point, and the label is next to the cross.
    // Otherwise, the label is where the line enters or leaves the plot.
    function named(pen, term, values, color) {
      const [x, y] = term in nearAxis.read ? [pen.x(nearAxis.read[term][0]), pen.y(nearAxis.read[term][1] * unit()[1])] : [NaN, NaN];
      if (pen.inside(x, y)) {
        pen.cross(x, y, color);
        pen.label(caption(term), [[x - 14, y + 12], [x + 14, y - 12], [x + 14, y + 12]], color);
        return;
      }
      const points = within(pen, values);
      const endPoints = points.length && points[0][1] > points[points.length - 1][1] + 2 ? [points[0], points[points.length - 1]] : [points[points.length - 1], points[0]];
      if (points.length) pen.label(caption(term), endPoints.flatMap(([ex, ey]) => [[ex, ey - 11], [ex, ey + 11]]), color);
    }

    function draw(pen) {
      const factor = unit()[1];
      const color = ink(nearAxis.label);
      const line = (values, style) => pen.line(tau, times(values, factor), style);
      for (const a of visible()) {
        pen.area(tau, times(a.low, factor), times(a.high, factor), ink(`${a.label}-faint`));
        if (shownKeys.has('model')) line(a.fit, { color: ink(a.label), width: 1.6 });
      }
      const isShown = shownKeys.has(nearAxis.label);
      const parts = isShown && shownKeys.has('model') ? Object.entries(nearAxis.parts) : [];
      const limits = isShown && shownKeys.has('limits') ? Object.entries(nearAxis.upper) : [];
      const references = isShown && shownKeys.has('references') ? sensor.references.filter((r) => r.axis === nearAxis.name) : [];
      if (limits.length) pen.area(tau, times(nearAxis.fit, factor), times(nearAxis.most, factor), ink(`${nearAxis.label}-faint`));
      for (const [, values] of limits) line(values, { color, dash: LIMIT, width: 1 });
      // vibrations and resonances are marked in the chart of the noise density
      const dashedParts = parts.filter(([term]) => !/^(sine|resonance)/.test(term));
      for (const [term, values] of dashedParts) line(values, { color, dash: DASHES[term] || PROCESS, width: 1.2 });
      for (const other of references) line(other.adev, { color: 'var(--ink-2)', dash: REFERENCE });
      for (const a of visible()) pen.marks(tau, times(a.adev, factor), a.label, ink(a.label));
      for (const [term, values] of parts) if (term in DASHES) named(pen, term, times(values, factor), color);
      const nameAt = (words, values, down) => {
        const points = within(pen, times(values, factor));
        pen.label(words, points.slice(Math.floor(points.length / 3)).map(([x, y]) => [x, y + down]), 'var(--ink-2)');
      };
      for (const [term, values] of limits) nameAt(`${term} limit`, values, 12);
      for (const other of references) nameAt(other.name, other.adev, -12);
    }

    // Select the axis whose curve is nearest to the cursor: the parts of its model are drawn.
    function focus(at, value) {
      const distance = (a) => (a.adev[at] > 0 && value > 0 ? Math.abs(Math.log(a.adev[at] * unit()[1] / value)) : Infinity);
      const [found] = visible().sort((a, b) => distance(a) - distance(b));
      if (!found || found === nearAxis || distance(found) === Infinity) return false;
      nearAxis = found;
      note();
      return true;
    }

    function describe(at) {
      const [name, factor] = unit();
      const measured = visible().filter((a) => a.adev[at] > 0).map((a) => [
        `${a.label}  ${number(a.adev[at] * factor)} ${name}  (${span(a.low[at] * factor, a.high[at] * factor)})`, ink(a.label)]);
      const parts = Object.entries(nearAxis.parts).filter(([, values]) => values[at] > 0).map(([term, values]) => `${caption(term)} ${number(values[at] * factor, 3)}`);
      return [
        [`τ ${number(tau[at])} s`, ''], ...measured,
        ...(parts.length ? [[`model of ${nearAxis.label}: ${parts.join(', ')}`, '']] : []),
        ...(nearAxis.n[at] ? [[`${nearAxis.n[at].toLocaleString('en')} differences`, '']] : []),
      ];
    }

    const chart = create(host, {
      title: `${sensor.title}: Allan deviation`, name: `allan_${sensor.sensor}`, height: 384, zoomY: true, xs: tau,
      x: { log: true, full: () => [tau[0] / 1.25, tau[tau.length - 1] * 1.35], label: () => 'averaging time τ [s]' },
      y: { log: true, full: fullY, label: () => `Allan deviation σ(τ) [${unit()[0]}]` },
      legend: () => visible().map((a) => a.label), draw, focus, describe,
    });
    const others = [{ key: 'model', text: 'model', dash: '' }];
    if (axes.some((a) => Object.keys(a.upper).length)) others.push({ key: 'limits', text: 'limits', dash: LIMIT });
    if (sensor.references.length) others.push({ key: 'references', text: [...new Set(sensor.references.map((r) => r.name))].join(', '), dash: REFERENCE });
    below(host, chart, axes, shownKeys, others, () => { if (!shownKeys.has(nearAxis.label) && visible().length) [nearAxis] = visible(); note(); });
    const text = element('p', { class: 'note' });
    host.append(text);
    function note() {
      text.textContent = `Points: measured, with 68\u00a0% intervals. Solid lines: models. Dashed lines: parts of the model of ${nearAxis.label}, without vibrations (point at a curve to see its parts). Crosses: values from which N (at 1 s) and K (at 3 s) are read.`
        + (Object.keys(nearAxis.upper).length ? ' Shaded: the model with unresolved terms up to their 95\u00a0% limits (dotted lines).' : '')
        + (nearAxis.unresolved.length ? ' A term with "?" is not resolved.' : '');
    }
    note();
    chart.render();
    return [chart];
  }

  function density(host, sensor, page) {
    const { x, axes, lines } = sensor.density;
    const shownKeys = new Set();
    const unit = () => sensor.units[page.units()].density;
    const visible = () => axes.filter((a) => shownKeys.has(letter(a.name)));
    const chart = create(host, {
      title: `${sensor.title}: noise density`, name: `density_${sensor.sensor}`, height: 300, zoomY: true, xs: x,
      x: { log: true, full: () => [x[0] / 1.2, x[x.length - 1] * 1.2], label: () => 'frequency [Hz]' },
      y: {
        log: true, label: () => `noise density [${unit()[0]}]`,
        full() {
          const values = positive(axes.map((a) => times(a.density, unit()[1])));
          return [0.6 * Math.min(...values), 1.6 * Math.max(...values)];
        },
      },
      legend: () => visible().map((a) => letter(a.name)),
      draw(pen) {
        for (const a of visible()) pen.line(x, times(a.density, unit()[1]), { color: ink(letter(a.name)), width: 0.8 });
        for (const a of visible()) pen.line(x, times(a.fit, unit()[1]), { color: ink(letter(a.name)), width: 2, dash: '7 4' });
        lines.forEach(([f, of], i) => pen.rule(f, 'var(--moved)', i < LINES ? `${number(f, 2)} Hz ${of}` : '', '2 3'));
      },
      describe: (at) => [
        [`${number(x[at])} Hz`, ''],
        ...visible().filter((a) => a.density[at] > 0).map((a) => {
          const [name, factor] = unit();
          return [`${letter(a.name)}  ${number(a.density[at] * factor)} ${name}  (${span(a.low[at] * factor, a.high[at] * factor)})`, ink(letter(a.name))];
        }),
      ],
    });
    below(host, chart, axes, shownKeys);
    host.append(element('p', { class: 'note' }, `Dashed lines: the model within the pass band. Its flat part is √2 N, the noise density of datasheets.${lines.length ? ' Vertical lines: vibrations and resonances, with their axes.' : ''}`));
    chart.render();
    return [chart];
  }

  // Kind of a marked time -> color, hatching or line, text at the cursor, and text below the chart.
  const KINDS = {
    motion: ['moved', 'up', 'excluded: the IMU moved', 'Hatched to the upper right: the IMU moved.'],
    stuck: ['bad', 'down', 'excluded: an axis repeated one value', 'Hatched red: an axis repeated one value.'],
    other: ['excluded', 'down', 'excluded', 'Hatched gray: excluded (warm-up, or another rate).'],
    gap: ['gap', '', 'no samples', 'Gray: no samples.'],
    shock: ['bad', 'mark', 'shock', 'Dashed lines: shocks.'],
    noise_increased: ['moved', 'down', 'excluded: noise increased', 'Hatched to the lower right: noise increased.'],
  };

  // Return the unit of time in the charts (s, min or h): its length in s, and its name.
  function clock(page) {
    const { time } = page.times;
    const length = time[time.length - 1];
    if (length > 7200) return [3600, 'h'];
    return length > 180 ? [60, 'min'] : [1, 's'];
  }

  // Draw the excluded times, shocks and starts of recordings.
  function events(pen, page) {
    const [scale] = clock(page);
    for (const [from, to, kind] of page.times.bands) {
      const [color, how] = KINDS[kind];
      if (how === 'mark') pen.rule(from / scale, ink(color), '', '3 2');
      else pen.stripe(from / scale, to / scale, ink(color), how);
    }
    for (const start of page.times.starts) pen.rule(start / scale, 'var(--ink-2)');
  }

  const during = (page, seconds, bin) => page.times.bands.filter(([from, to]) => from < seconds + bin && to >= seconds - bin)
    .map(([, , kind]) => [KINDS[kind][2], '']).slice(0, 2);

  // Return the text that explains the marked times.
  function explained(page) {
    const kinds = new Set(page.times.bands.map(([, , kind]) => kind));
    return [...Object.keys(KINDS).filter((kind) => kinds.has(kind)).map((kind) => KINDS[kind][3]), ...(page.times.starts.length ? ['Vertical lines: start of the next recording.'] : [])].join(' ');
  }

  // Draw the bias and the noise of all axes over time, and the bias over temperature as single points.
  function trends(host, sensor, page) {
    return sensor.trends.map((data) => {
      const [title, what] = { bias: ['bias over time', 'bias minus its mean'], temperature: ['bias against temperature', 'bias minus its mean'], noise: ['noise over time', 'noise of single samples'] }[data.kind];
      const points = data.kind === 'temperature';
      const [scale, name] = points ? [1, '°C'] : clock(page);
      const x = data.x.map((v) => v / scale);
      const [first, last] = points ? [Math.min(...x), Math.max(...x)] : [0, page.times.time[page.times.time.length - 1] / scale];
      const shownKeys = new Set();
      const unit = () => sensor.units[page.units()].curve;
      const visible = () => data.lines.filter((line) => shownKeys.has(letter(line.name)));
      const chart = create(host, {
        title: `${sensor.title}: ${title}`, name: `${data.kind}_${sensor.sensor}`, height: 220, xs: x,
        x: { full: () => [first, last], label: () => (points ? 'temperature [°C]' : `time [${name}]`) },
        y: {
          label: () => `${what} [${unit()[0]}]`,
          full() {
            const values = data.lines.flatMap((line) => times(line.values, unit()[1])).filter((v) => v !== null);
            const [low, high] = [Math.min(...values), Math.max(...values)];
            const room = 0.08 * (high - low) || 1e-9;
            return [data.kind === 'noise' ? 0 : low - room, high + room];
          },
        },
        legend: () => visible().map((line) => letter(line.name)),
        draw(pen) {
          for (const line of visible()) {
            const label = letter(line.name);
            const values = times(line.values, unit()[1]);
            const fit = points ? data.fits[data.lines.indexOf(line)] : null;
            if (points) pen.marks(x, values, label, ink(label), 1.6, ink(label));
            if (fit || !points) pen.line(x, fit ? times(fit, unit()[1]) : values, { color: ink(label), width: 1.3 });
          }
          if (!points) events(pen, page);
        },
        describe: (at) => [
          [`${number(x[at])} ${name}`, ''],
          ...visible().filter((line) => line.values[at] !== null).map((line) => [`${letter(line.name)}  ${number(line.values[at] * unit()[1])} ${unit()[0]}`, ink(letter(line.name))]),
          ...(points ? [] : during(page, data.x[at], data.span / 2)),
        ],
      });
      below(host, chart, data.lines, shownKeys);
      const text = element('p', { class: 'note' });
      host.append(text);
      const listed = (values) => {
        const axisValues = data.lines.map((line, i) => [letter(line.name), values[i]]).filter(([, v]) => v !== null);
        return `${axisValues.map(([axis, v]) => `${axis} ${number(v * unit()[1], 3)}`).join(', ')} ${unit()[0]}`;
      };
      chart.note = () => {
        const parts = [data.kind === 'noise' ? `Averages over ${number(data.span, 3)} s of the differences of successive samples; constant if the noise does not change.` : `Averages over ${number(data.span, 3)} s at rest.`];
        if (points) parts.push(data.fits.length ? `Lines: fitted b(T), with 95 % intervals: ${data.text[page.units()]}` : '');
        if (data.white && data.white.some((v) => v !== null)) parts.push(`With white noise alone, 95 % of the averages would lie within these distances from 0: ${listed(data.white)}.`);
        text.textContent = [...parts, points ? '' : explained(page)].join(' ');
      };
      chart.note();
      chart.render();
      return chart;
    });
  }

  function signal(host, sensor, page) {
    const [scale, name] = clock(page);
    const seconds = page.times.time;
    const x = seconds.map((t) => t / scale);
    const bin = x.length > 1 ? seconds[1] - seconds[0] : 0;
    const signalCharts = sensor.signal.map((a) => {
      const label = letter(a.name);
      const unit = () => sensor.units[page.units()].signal;
      return create(host, {
        title: `${sensor.title}: raw signal ${label}`, name: `signal_${a.name}`, height: 150, xs: x,
        x: { full: () => [0, x[x.length - 1]], label: () => `time [${name}]` },
        // The range is chosen for the used samples; an excluded shock may extend beyond the range.
        y: { full: () => [-1.15 * a.reach * unit()[1], 1.15 * a.reach * unit()[1]], label: () => `${label} [${unit()[0]}], 0 = median ${number(a.middle * unit()[1])}` },
        draw(pen) {
          pen.area(x, times(a.low, unit()[1]), times(a.high, unit()[1]), ink(label));
          events(pen, page);
        },
        describe(at) {
          const celsius = page.temperature ? reading(page.temperature, seconds[at]) : null;
          return [
            [`${number(x[at])} ${name}`, ''],
            [`${label}  ${span(a.low[at] * unit()[1], a.high[at] * unit()[1])} ${unit()[0]}`, ink(label)],
            ...(celsius === null ? [] : [[`${number(celsius, 3)} °C`, '']]),
            ...during(page, seconds[at], bin),
          ];
        },
      });
    });
    host.append(element('p', { class: 'note' }, `Lowest and highest sample of each short interval. ${explained(page)}`));
    return signalCharts;
  }

  // Return the temperature reading nearest to the time `at` in s.
  function reading({ time, celsius }, at) {
    const distances = time.map((t, i) => (celsius[i] === null ? Infinity : Math.abs(t - at)));
    return celsius[distances.indexOf(Math.min(...distances))];
  }

  function temperature(host, page) {
    const { source, time, celsius } = page.temperature;
    const [scale, name] = clock(page);
    const readings = celsius.filter((v) => v !== null);
    const [low, high] = [Math.min(...readings), Math.max(...readings)];
    const room = Math.max(0.08 * (high - low), 0.2);
    const x = time.map((t) => t / scale);
    const chart = create(host, {
      title: 'Temperature', name: 'temperature', height: 170, xs: x,
      x: { full: () => [0, page.times.time[page.times.time.length - 1] / scale], label: () => `time [${name}]` },
      y: { full: () => [low - room, high + room], label: () => 'temperature [°C]' },
      draw(pen) { pen.line(x, celsius, { color: 'var(--ink)', width: 1.3 }); events(pen, page); },
      describe: (at) => [[`${number(x[at])} ${name}`, ''], [`${number(celsius[at])} °C`, '']],
    });
    host.append(element('p', { class: 'note' }, `${number(low, 3)} to ${number(high, 3)} °C, from ${source}. The coefficients are computed without the temperature.`));
    return [chart];
  }

  // Draw the error of each drive divided by its prediction, against the duration and the angle turned.
  function motion(host, page) {
    const { drives } = page.motion;
    const kinds = [['rotation', 'angle', 'x'], ['velocity', 'velocity', 'y']];
    const largestRatio = Math.max(1, ...kinds.flatMap(([key]) => drives[key]));
    const motionCharts = [['duration', 'duration of the drive [s]', 's'], ['turned', 'angle turned [°]', '°']].map(([key, label, unit]) => {
      const x = drives[key];
      const last = Math.max(...x);
      const shownKeys = new Set();
      const cell = element('div');
      host.append(cell);
      const visible = () => kinds.filter(([kind]) => shownKeys.has(kind));
      const chart = create(cell, {
        title: `Error in motion: ${label}`, name: `motion_${key}`, height: 220, xs: x,
        x: { full: () => [0, 1.05 * last || 1], label: () => label },
        y: { full: () => [0, 1.1 * largestRatio], label: () => 'error / predicted error' },
        draw(pen) {
          pen.line([0, 1.05 * last || 1], [1, 1], { color: 'var(--ink-2)', dash: REFERENCE });
          for (const [kind, , color] of visible()) pen.marks(x, drives[kind], color, ink(color), 2.6, ink(color));
        },
        describe: (at) => [
          [`${number(drives.duration[at], 3)} s, ${number(drives.turned[at], 3)}°`, ''],
          ...visible().map(([kind, text, color]) => [`${text} error  ${number(drives[kind][at], 3)} times its prediction`, ink(color)]),
        ],
      });
      below(cell, chart, [], shownKeys, kinds.map(([kind, text, color]) => ({ key: kind, text: `${text} error`, color: ink(color) })));
      chart.render();
      return chart;
    });
    return motionCharts;
  }

  return { allan, density, trends, signal, temperature, motion };
})();
