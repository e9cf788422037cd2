// A page opened as a file may not start a worker, which the search runs in. Then a hidden frame does its work:
// it loads the same script and answers by messages, too.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.waiting = []
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.inner = frame.contentWindow
      this.inner.postMessage = (data) => this.tell(data) // from the script inside to the page
      this.inner.importScripts = (...names) => names.reduce((last, name) => last.then(() => this.load(name)), Promise.resolve())
      this.load(url).then(() => { this.ready = true; this.waiting.splice(0).forEach((data) => this.postMessage(data)) })
    }
    load(name) {
      return new Promise((done, failed) => {
        const script = this.inner.document.createElement("script")
        Object.assign(script, { src: new URL(name, document.baseURI).href, onload: done, onerror: failed })
        this.inner.document.body.append(script)
      })
    }
    tell(data) {
      const event = new MessageEvent("message", { data })
      this.dispatchEvent(event)
      if (this.onmessage) this.onmessage(event)
    }
    postMessage(data) {
      if (this.ready) this.inner.dispatchEvent(new MessageEvent("message", { data }))
      else this.waiting.push(data)
    }
    terminate() {}
  }
}
