// Where the processor draws, edges are not smoothed: that would take twice as long. The library asks for it
// when it opens the canvas, and it cannot be changed afterwards.
(() => {
  const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
  const open = HTMLCanvasElement.prototype.getContext;
  const probe = open.call(document.createElement("canvas"), "webgl2");
  const names = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? probe.getParameter(names.UNMASKED_RENDERER_WEBGL) : probe?.getParameter(probe.RENDERER);
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  if (!SOFTWARE.test(name)) return;
  HTMLCanvasElement.prototype.getContext = function (kind, wanted) {
    return open.call(this, kind, kind.startsWith("webgl") ? { ...wanted, antialias: false } : wanted);
  };
})();
