// Requests of which only the newest counts.

/**
 * At most one request at a time; what is asked meanwhile waits, and the newest wish replaces older
 * ones. While a light is dragged this shows as many sketches as the service can make.
 */
export class Latest {
  /**
   * @param {(wish, signal: AbortSignal) => Promise} act
   * @param {(error: Error) => void} failed
   */
  constructor(act, failed, { interrupts = false } = {}) {
    this.act = act;
    this.failed = failed;
    this.interrupts = interrupts; // whether a newer wish aborts the one under way
    this.waiting = null;
    this.busy = false;
  }

  ask(wish) {
    this.waiting = { wish };
    if (this.busy && this.interrupts) this.control.abort();
    if (!this.busy) this.run();
  }

  /** Forget what waits, and end what runs. */
  drop() {
    this.waiting = null;
    this.control?.abort();
  }

  async run() {
    this.busy = true;
    while (this.waiting) {
      const { wish } = this.waiting;
      this.waiting = null;
      this.control = new AbortController();
      try {
        await this.act(wish, this.control.signal);
      } catch (error) {
        if (error.name !== "AbortError") this.failed(error);
      }
    }
    this.busy = false;
  }
}
