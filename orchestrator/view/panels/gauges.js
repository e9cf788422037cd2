// Bars and numbers. Written to the page directly: a few times a second, without rendering anything anew.
export default {
  template: `
    <div class="gauges">
      <section v-for="group in groups" :key="group.title">
        <h2>{{ group.title }}</h2>
        <div v-for="gauge in group.gauges" :key="gauge.text" class="gauge" ref="lines">
          <span>{{ gauge.text }}</span>
          <div class="bar"><i></i><b :style="{ left: 100 * gauge.zero + '%' }" v-if="gauge.zero > 0"></b></div>
          <output>–</output><small>{{ gauge.unit }}</small>
        </div>
      </section>
      <div class="legend" v-if="scale.length">
        <div :style="{ background: 'linear-gradient(to right,' + scale.join() + ')' }"></div>
        <span>0</span><span>chamber pressure</span><span>{{ full }} MPa</span>
      </div>
    </div>`,
  props: { groups: Array, scale: Array, full: Number },
  methods: {
    show(figures) {
      const lines = this.$el.querySelectorAll(".gauge");
      figures.forEach(([text, begin, end, colour, word], k) => {
        const line = lines[k];
        if (!line) return;
        const bar = line.querySelector("i");
        const output = line.querySelector("output");
        if (output.textContent !== text) output.textContent = text;
        bar.style.transform = `translateX(${100 * begin}%) scaleX(${end - begin})`;
        const unit = line.querySelector("small");
        unit.dataset.unit ??= unit.textContent;
        if (unit.textContent !== (word || unit.dataset.unit)) unit.textContent = word || unit.dataset.unit;
        line.classList.toggle("cavitates", Boolean(word));
        if (colour) bar.style.background = colour;
      });
    },
  },
};
