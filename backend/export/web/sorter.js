// SPDX-License-Identifier: GPL-3.0-or-later
// The order in which Gaussians are drawn: by depth along the camera's axis, the farthest first; of those of one
// depth the later one first. A worker of its own, made from this text, so that the page never waits for it.

function sorting() {
  let position, count, keys, first, second;
  const low = new Uint32Array(65536), high = new Uint32Array(65536);

  /** Where each bucket begins, of how many there are in it. */
  function begins(counts) {
    let sum = 0;
    for (let b = 0; b < 65536; b++) { const here = counts[b]; counts[b] = sum; sum += here; }
  }

  onmessage = ({ data }) => {
    if (data.position) {
      position = data.position;
      count = position.length / 3;
      keys = new Float32Array(count);
      first = new Uint32Array(count);
      second = new Uint32Array(count);
      return;
    }
    const [x, y, z, offset] = data.axis, bits = new Int32Array(keys.buffer);
    low.fill(0);
    high.fill(0);
    for (let i = 0; i < count; i++) {
      keys[i] = x * position[3 * i] + y * position[3 * i + 1] + z * position[3 * i + 2] - offset;
      // Whole numbers that rise as the depth falls: a float's bits do, once those of negative ones are turned.
      const key = ~(bits[i] ^ (bits[i] >> 31 | 0x80000000));
      bits[i] = key;
      low[key & 65535]++;
      high[key >>> 16]++;
    }
    begins(low);
    begins(high);
    for (let i = count - 1, k; i >= 0; i--) { k = bits[i] & 65535; first[low[k]++] = i; }
    for (let r = 0, i, k; r < count; r++) { i = first[r]; k = bits[i] >>> 16; second[high[k]++] = i; }
    const order = data.order || new Uint32Array(count);
    order.set(second);
    postMessage({ order, serial: data.serial }, [order.buffer]);
  };
}

class Sorter {
  /**
   * `arrived(order)` is called with the indices `[N]`; it gives the array back by `ask`. `failed()` is called where
   * the worker has ended by an error: no order comes any more.
   */
  constructor(position, arrived, failed) {
    const url = URL.createObjectURL(new Blob([`(${sorting})()`], { type: "text/javascript" }));
    this.worker = new Worker(url);
    this.spare = null;
    this.isBusy = false;
    this.worker.onmessage = ({ data }) => {
      this.isBusy = false;
      arrived(data.order, data.serial);
      this.spare = data.order;
    };
    this.worker.onerror = this.worker.onmessageerror = () => failed();
    const copy = position.slice();
    this.worker.postMessage({ position: copy }, [copy.buffer]);
  }

  /** Sort along a view: `axis` unit vector, `offset` its product with the eye. False while it is at work. */
  ask(axis, offset, serial) {
    if (this.isBusy) return false;
    this.isBusy = true;
    const order = this.spare;
    this.spare = null;
    this.worker.postMessage({ axis: [...axis, offset], order, serial }, order ? [order.buffer] : []);
    return true;
  }
}
