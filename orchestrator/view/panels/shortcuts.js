// Keys for the page: wherever the focus is, but in a field or in a window that is open over the page.
export default {
  template: `<i hidden></i>`,
  props: { codes: Array },
  mounted() {
    this.press = (event) => {
      const plain = !(event.ctrlKey || event.altKey || event.metaKey || event.repeat);
      const inside = event.target.closest?.("input, textarea, select, [role=dialog], [role=listbox]");
      if (plain && !inside && this.codes.includes(event.code)) this.$emit("press", event.code);
    };
    document.addEventListener("keydown", this.press);
  },
  unmounted() {
    document.removeEventListener("keydown", this.press);
  },
};
