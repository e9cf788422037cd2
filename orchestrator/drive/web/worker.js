// The way to the server, in a thread of its own: the page may be busy with a picture when a message is due.
// What the page said last is repeated for a quarter of a second and no longer. Then the dead-man counts as
// released until the page itself has said so; a page that stays away is silent in the end.

const PERIOD = 30; // ms between two messages
const FRESH = 250; // ms that a word of the page counts
const GONE = 1000; // ms after which nothing is sent for the page
const AGAIN = 1000; // ms until the next attempt
const DEAD = 10000; // ms of silence of the server, which speaks ten times a second, after which to connect again

const REST = [0, 0, 0, 0];
let [address, socket, number, heard] = ["", null, 0, 0];
let [sticks, held, said, late, sent] = [REST, false, -Infinity, false, false];

function open() {
  const mine = new WebSocket(address);
  [socket, number, heard] = [mine, 0, performance.now()];
  mine.onopen = () => postMessage({ open: true });
  mine.onmessage = (event) => {
    if (mine !== socket) return;
    heard = performance.now();
    postMessage({ ...JSON.parse(event.data), heard }); // the page may be busy: its own clock would be late
  };
  mine.onclose = () => mine === socket && gone();
}

function gone() {
  postMessage({ open: false });
  socket = null;
  setTimeout(open, AGAIN);
}

function slow(now) {
  late = now;
  postMessage({ late });
}

function send() {
  if (socket && performance.now() - heard > DEAD) {
    socket.close(); // without waiting for an answer
    gone();
  }
  const silence = performance.now() - said;
  if (silence > FRESH && held && !late) slow(true);
  // what the network has not taken yet would arrive late: better the next one
  if (silence > GONE || socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > 0) return;
  sent = held && !late && silence <= FRESH;
  const rounded = (sent ? sticks : REST).map((value) => Math.round(value * 1000) / 1000);
  socket.send(JSON.stringify({ n: number++, sticks: rounded, dead_man: sent }));
}

onmessage = ({ data }) => {
  if (data.address) {
    address = data.address;
    open();
    setInterval(send, PERIOD);
  } else if (data.do) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(data));
  } else if (data.quiet) {
    [held, said] = [false, -Infinity];
    if (late) slow(false);
  } else {
    // a word that comes late is one too many: what the hands did meanwhile nobody has seen
    if (performance.now() - said > FRESH && held && !late) slow(true);
    const first = said === -Infinity;
    [sticks, held, said] = [data.sticks, data.held, performance.now()];
    if (!held && late) slow(false);
    // at once; after silence too, or a hold that follows would overwrite the release that the server waits for
    if (!held && (sent || first)) send();
  }
};
