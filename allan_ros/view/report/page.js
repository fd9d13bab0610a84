// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Inserts the charts into the page, redraws them when the units are switched, and for printing.
'use strict';

(() => {
  const data = JSON.parse(document.getElementById('data').textContent);
  const PRINTED = { 1: 700, 2: 342 };  // width in pixels of a chart on A4, by the number of columns
  const FLATTER = 0.8;  // height of a printed chart, relative to the height on the screen
  const page = { ...data, units: () => (document.querySelector('input[name=units]:checked') || { value: data.units }).value };

  for (const host of document.querySelectorAll('.charts[data-kind]')) {
    const sensor = data.sensors.find((s) => s.sensor === host.dataset.sensor);
    if (sensor) Charts[host.dataset.kind](host, sensor, page);
    else Charts[host.dataset.kind](host, page);
  }

  for (const input of document.querySelectorAll('input[name=units]')) {
    input.addEventListener('change', () => Chart.all.forEach((chart) => { if (chart.note) chart.note(); chart.render(); }));
  }

  // For printing, all sections are opened, and the charts are drawn again for the width of the paper.
  const closedSections = [];
  addEventListener('beforeprint', () => {
    document.documentElement.classList.add('printing');
    closedSections.push(...document.querySelectorAll('details:not([open])'));
    for (const part of closedSections) part.open = true;
    for (const chart of Chart.all) {
      const columns = chart.box.closest('.pair') ? data.sensors.length : 1;
      chart.render(PRINTED[columns], FLATTER * chart.spec.height);
    }
  });
  addEventListener('afterprint', () => {
    document.documentElement.classList.remove('printing');
    for (const part of closedSections.splice(0)) part.open = false;
    for (const chart of Chart.all) chart.render();
  });
})();
