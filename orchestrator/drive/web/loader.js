// Unpacks the modules of the section before this script, and shows the machine; of many sections the first brings them.
(() => {
  const holder = document.currentScript.parentElement;
  const root = holder.querySelector(".harvester-machine");
  const text = (bytes) => new TextDecoder().decode(bytes);

  // bytes of a part: compressed, as base64
  async function part(name) {
    const element = holder.querySelector(`[data-part=${name}]`);
    if (!element) return null;
    const packed = Uint8Array.from(atob(element.textContent), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  async function modules() {
    const { uplot, ...scripts } = JSON.parse(text(await part("scripts")));
    const add = (type, textContent) => document.head.append(Object.assign(document.createElement("script"), { type, textContent }));
    const address = ([name, script]) => [name, `data:text/javascript,${encodeURIComponent(script)}`];
    if (!window.uPlot) add("text/javascript", uplot);
    add("importmap", JSON.stringify({ imports: Object.fromEntries(Object.entries(scripts).map(address)) }));
  }

  async function show() {
    await (window.harvesterModules ??= modules());
    const [data, bytes] = [JSON.parse(text(await part("data"))), await part("module")];
    const [{ Page }, { ModuleSource }, { Recording }] = await Promise.all(["page", "module", "recording"].map((name) => import(`drive/${name}.js`)));
    const log = (status, _, message) => status !== "OK" && status !== "warning" && console.warn(message);
    const sources = {};
    if (bytes) sources.drive = await ModuleSource.load(bytes, data, log);
    if (data.replay) sources.replay = new Recording(data.replay);
    root.machine = new Page(root, data, sources);
  }

  show().catch((problem) => {
    root.querySelector(".hm-said").textContent = problem.message;
    root.querySelector(".hm-said").classList.add("hm-bad");
    console.error(problem);
  });
})();
