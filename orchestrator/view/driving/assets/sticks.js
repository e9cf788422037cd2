// Two sticks on the screen, the dead-man's lamp, and the loop that sends what the hands do.

import { Keyboard, Link, elsewhere, merge, readGamepad } from "harvester-sticks";

const PERIOD = 30; // ms between two looks at the hands
const TOLD = 2500; // ms that a word about a key without controls stays
const REACH = 44; // px from the middle to the stop

const words = (hand) => `
  <text x="75" y="12">{{ legend.${hand}_up }}</text><text x="75" y="146">{{ legend.${hand}_down }}</text>
  <text v-for="(word, k) in (legend.${hand}_left ?? '').split(' ')" x="26" :y="38 + 11 * k" class="start">{{ word }}</text>
  <text v-for="(word, k) in (legend.${hand}_right ?? '').split(' ')" x="124" :y="38 + 11 * k" class="end">{{ word }}</text>`;

const stick = (hand, first) => `
  <svg viewBox="0 0 150 150" class="stick" data-hand="${hand}" role="img" aria-label="${hand} stick"
       @pointerdown.prevent="grab($event, '${hand}')" @pointermove="drag($event, '${hand}')"
       @pointerup="drop('${hand}')" @pointercancel="drop('${hand}')" @lostpointercapture="drop('${hand}')">
    <rect x="22" y="22" width="106" height="106" rx="14" class="plate" />
    <path d="M75 22V128M22 75H128" class="cross" />${words(hand)}
    <circle :cx="75 + ${REACH} * shown[${first}]" :cy="75 - ${REACH} * shown[${first + 1}]" r="17"
            class="knob" :class="{ live }" />
  </svg>`;

export default {
  template: `
    <div class="harvester-sticks" tabindex="0" role="application" ref="area"
         aria-label="Sticks: hold space or shift, left stick W A S D, right stick arrows or I J K L">
      ${stick("left", 0)}
      <div class="middle">
        <div class="lamp" :class="{ held, live }"></div>
        <div class="state" role="status">{{ state }}</div>
        <div class="note">{{ note }}</div>
      </div>
      ${stick("right", 2)}
    </div>`,
  props: { station: String, path: String, legend: Object },
  data: () => ({ refused: -Infinity, shown: [0, 0, 0, 0], held: false, live: false, state: "connecting", note: "" }),
  mounted() {
    this.screen = { left: null, right: null };
    this.status = null;
    this.keyboard = new Keyboard(() => this.driving(), () => this.refuse());
    this.link = new Link(this.path, this.station, (status) => this.told(status), () => this.slow());
    this.letGo = this.letGo.bind(this);
    this.clicked = this.clicked.bind(this);
    this.escape = this.escape.bind(this);
    for (const [target, name] of this.ends()) target.addEventListener(name, this.letGo);
    document.addEventListener("click", this.clicked);
    window.addEventListener("keydown", this.escape);
    this.last = performance.now();
    this.timer = setInterval(() => this.beat(), PERIOD);
  },
  unmounted() {
    clearInterval(this.timer);
    this.letGo();
    for (const [target, name] of this.ends()) target.removeEventListener(name, this.letGo);
    document.removeEventListener("click", this.clicked);
    window.removeEventListener("keydown", this.escape);
    this.keyboard.close();
    this.link.close();
  },
  methods: {
    ends: () => [
      [window, "blur"], [window, "pagehide"], [document, "visibilitychange"], [document, "freeze"],
      [document, "contextmenu"],
    ],
    driving() {
      return this.status?.role === "driving" && this.link.alive();
    },
    focus() {
      this.$refs.area.focus({ preventScroll: true });
    },
    told(status) {
      const before = this.status?.role;
      this.status = status;
      this.live = status?.live ?? false;
      if (status?.role === "driving" && before !== "driving") this.letGo();
    },
    // the picture has to cost less from now on: the scene and the server listen
    slow() {
      window.dispatchEvent(new CustomEvent("harvester-slow"));
      this.$emit("slow");
    },
    // a key of the sticks, but this page does not drive: the button that is missing shows itself
    refuse() {
      if (!["free", "watching"].includes(this.status?.role)) return;
      this.refused = performance.now();
      const button = document.querySelector(".take:not([disabled])");
      button?.animate([{ opacity: 1 }, { opacity: 0.15 }, { opacity: 1 }], { duration: 300, iterations: 3 });
    },
    // whatever is held counts as released; said to the server at once
    letGo() {
      this.keyboard.clear();
      this.screen = { left: null, right: null };
      if (this.driving()) this.link.send([0, 0, 0, 0], false);
    },
    beat() {
      const now = performance.now();
      const seconds = Math.min(0.1, (now - this.last) / 1000);
      this.last = now;
      if (document.hidden || !document.hasFocus()) this.keyboard.clear();
      const pad = document.hidden || !document.hasFocus() ? merge([]) : readGamepad();
      const hands = merge([this.keyboard.read(seconds), pad, this.touch()]);
      const driving = this.driving();
      this.shown = driving ? hands.sticks : [0, 0, 0, 0];
      this.held = driving && hands.deadMan;
      this.note = pad.note ?? "";
      this.state = this.describe();
      const speaks = driving && !document.hidden;
      if (speaks) this.link.send(hands.sticks, hands.deadMan);
      else if (this.spoke) this.link.quiet();
      this.spoke = speaks;
    },
    describe() {
      if (!this.status || !this.link.alive()) return "no connection";
      const refused = performance.now() - this.refused < TOLD;
      if (this.status.role === "watching") return `another page drives${refused ? ': press "Request controls"' : ""}`;
      if (this.status.role === "free" && refused && this.status.drives) return 'press "Take controls" first';
      if (this.status.role === "free") return this.status.why;
      if (elsewhere(document.activeElement)) return "Esc: back to the sticks";
      if (this.link.late) return "this page was too slow: release Space, then hold it again";
      return this.live ? "driving" : this.status.why;
    },
    touch() {
      const { left, right } = this.screen;
      const sticks = [...(left?.at ?? [0, 0]), ...(right?.at ?? [0, 0])];
      return { sticks, deadMan: left !== null || right !== null };
    },
    grab(event, hand) {
      event.currentTarget.setPointerCapture(event.pointerId);
      this.focus();
      this.screen[hand] = { pointer: event.pointerId, at: [0, 0] };
      this.drag(event, hand);
    },
    drag(event, hand) {
      if (this.screen[hand]?.pointer !== event.pointerId) return;
      const box = event.currentTarget.getBoundingClientRect();
      const scale = (REACH * box.width) / 150;
      const share = (offset) => Math.max(-1, Math.min(1, offset / scale));
      const across = share(event.clientX - box.left - box.width / 2);
      this.screen[hand].at = [across, -share(event.clientY - box.top - box.height / 2)];
    },
    drop(hand) {
      this.screen[hand] = null;
    },
    // after a click with the mouse the keys belong to the sticks again; after one by keyboard they stay there
    clicked(event) {
      const field = document.activeElement?.matches("input,textarea,select,[contenteditable]");
      if (event.detail > 0 && this.driving() && !field) this.focus();
    },
    escape(event) {
      if (event.code === "Escape" && this.driving()) this.focus();
    },
  },
};
