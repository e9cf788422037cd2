// A line of names and values, written directly; cells come and go with the state.
export default {
  template: `<div class="foot" role="status"></div>`,
  methods: {
    show(cells) {
      const line = this.$el;
      while (line.children.length > cells.length) line.lastChild.remove();
      cells.forEach(([name, text, tone], k) => {
        if (!line.children[k]) {
          const cell = document.createElement("span");
          cell.append(document.createElement("small"), document.createElement("b"));
          line.append(cell);
        }
        const [label, value] = line.children[k].children;
        if (label.textContent !== name) label.textContent = name;
        if (value.textContent !== text) value.textContent = text;
        if (line.children[k].className !== tone) line.children[k].className = tone;
      });
    },
  },
};
