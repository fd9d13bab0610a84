// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Inserts the charts into the page, and provides the switch of units, copying and printing.
'use strict';

(() => {
  const { element } = Chart;
  const data = JSON.parse(document.getElementById('data').textContent);
  const charts = [];
  const chosen = () => (document.querySelector('input[name=units]:checked') || { value: data.units }).value;

  document.documentElement.classList.add('scripted');
  for (const sensor of data.sensors) {
    if (sensor.axes.some((a) => a.adev && a.adev.some((v) => v > 0))) {
      const place = (kind, where) => {
        const host = document.querySelector(`.charts.${where}[data-sensor=${sensor.sensor}]`);
        const made = element('div', { class: `chart ${kind}` });
        host.hidden = false;
        host.append(made);
        return made;
      };
      charts.push(AllanChart.create(place('allan', 'curve'), sensor, chosen()));
      for (const trend of sensor.trends) charts.push(OtherCharts.trend(place('trend', 'rest'), sensor, chosen(), trend));
      if (sensor.spectrum) charts.push(OtherCharts.spectrum(place('spectrum', 'rest'), sensor, chosen()));
      if (sensor.signal) {
        const { time } = sensor.signal;
        if (data.temperature) OtherCharts.temperature(place('temperature', 'rest'), data.temperature, time[time.length - 1]);
        charts.push(OtherCharts.signal(place('signal', 'rest'), sensor, chosen(), data.temperature));
      }
    }
    copyButtons(document.querySelector(`.copy[data-sensor=${sensor.sensor}]`), sensor);
  }

  for (const input of document.querySelectorAll('input[name=units]')) {
    input.addEventListener('change', () => charts.forEach((chart) => chart.units(chosen())));
  }

  function copyButtons(host, sensor) {
    const status = element('span', { role: 'status' });
    host.append(element('span', {}, 'copy as'));
    const offers = { ...Object.fromEntries(Object.keys(sensor.copy[data.units]).map((form) => [form, () => sensor.copy[chosen()][form]])), 'curve (TSV)': () => curve(sensor) };
    for (const [form, text] of Object.entries(offers)) {
      const button = element('button', { type: 'button' }, form);
      button.addEventListener('click', async () => {
        status.textContent = (await copy(text())) ? `${form} copied` : 'the browser does not allow it';
      });
      host.append(button);
    }
    const file = element('button', { type: 'button', 'data-form': 'CSV' }, 'CSV');
    file.addEventListener('click', () => Picture.save(new Blob([csv(sensor)], { type: 'text/csv' }), `coefficients_${sensor.sensor}.csv`));
    host.append(element('span', { class: 'grow' }), element('span', { class: 'save' }, 'save as', file), status);
    host.hidden = false;
  }

  const csv = (sensor) => sensor.copy[chosen()].TSV.replaceAll('\t', ',');

  // The curve of all axes in SI, a line for each averaging time.
  function curve(sensor) {
    const axes = sensor.axes.filter((a) => a.adev);
    const head = ['tau_s', ...axes.flatMap((a) => ['adev', 'low68', 'high68', 'n'].map((what) => `${a.name}_${what}`))];
    const rows = sensor.tau.map((tau, i) => [tau, ...axes.flatMap((a) => [a.adev[i], a.low[i], a.high[i], a.n[i]])]);
    return [head, ...rows].map((row) => row.map((v) => (v === null ? '' : v)).join('\t')).join('\n') + '\n';
  }

  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      // A page from a file, or an older browser: through a selection.
      const area = element('textarea', { class: 'spoken', 'aria-hidden': 'true' });
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand('copy');
      area.remove();
      return done;
    }
  }

  // In print, each Allan chart is a vector picture on white, and raw signals are omitted.
  addEventListener('beforeprint', () => {
    document.documentElement.classList.add('printing');
    for (const folded of document.querySelectorAll('details:not([open]):not(.fold)')) {
      folded.open = true;
      folded.dataset.folded = '';
    }
    for (const chart of Chart.all.filter((u) => u.title)) {
      const figure = element('figure', { class: 'paper' });
      figure.innerHTML = Picture.svg(chart, chart.title);
      chart.root.closest('.plot').before(figure);
    }
    Chart.redrawAll();
  });
  addEventListener('afterprint', () => {
    document.documentElement.classList.remove('printing');
    for (const folded of document.querySelectorAll('details[data-folded]')) folded.open = false;
    for (const figure of document.querySelectorAll('figure.paper')) figure.remove();
    Chart.redrawAll();
  });
})();
