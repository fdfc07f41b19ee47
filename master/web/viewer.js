"use strict";
/* The viewer of one picture: zoom and pan over an <img>, by wheel, drag, keys and buttons.
 * Scale is in CSS pixels a picture pixel; null: as large as fits. The place under the pointer is
 * told in pixels of the full picture, as --crop counts them. */

const viewer = {
  box: document.getElementById("viewer"), image: document.getElementById("picture"),
  scale: null, x: 0, y: 0, origin: [0, 0], url: null,

  fitScale() {
    const { naturalWidth: w, naturalHeight: h } = this.image;
    return w ? Math.min(this.box.clientWidth / w, this.box.clientHeight / h, 8) : 1;
  },

  /* Keeps the picture within reach: centred where it is smaller than the box. */
  place() {
    const { naturalWidth: w, naturalHeight: h } = this.image;
    const s = this.scale ?? this.fitScale();
    const hold = (at, size, room) => (size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, at)));
    this.x = hold(this.scale ? this.x : 0, w * s, this.box.clientWidth);
    this.y = hold(this.scale ? this.y : 0, h * s, this.box.clientHeight);
    this.image.style.width = w * s + "px";
    this.image.style.height = h * s + "px";
    this.image.style.transform = "translate(" + this.x + "px," + this.y + "px)";
    this.image.classList.toggle("sharp", s > 1);
    document.getElementById("zoom").textContent = w ? Math.round(100 * s) + " %" : "";
  },

  /* Zooms about a point of the box, which stays where it is. */
  zoomTo(scale, px = this.box.clientWidth / 2, py = this.box.clientHeight / 2) {
    const now = this.scale ?? this.fitScale();
    const to = Math.min(64, Math.max(1 / 16, scale));
    this.x = px - (px - this.x) * to / now;
    this.y = py - (py - this.y) * to / now;
    this.scale = to;
    this.place();
  },

  zoomBy(factor, px, py) { this.zoomTo((this.scale ?? this.fitScale()) * factor, px, py); },
  fit() { this.scale = null; this.place(); },

  move(dx, dy) {
    this.scale ??= this.fitScale();
    this.x += dx;
    this.y += dy;
    this.place();
  },

  /* `origin`: of the crop in the full picture. The old picture stays until the new one is there. */
  show(url, description, origin) {
    const old = this.url;
    this.url = url;
    this.origin = origin;
    this.image.src = url;
    this.image.alt = description;
    if (old) URL.revokeObjectURL(old);
  },

  clear() {
    this.image.removeAttribute("src");
    this.image.alt = "";
    this.scale = null;
    document.getElementById("place").textContent = "";
  },

  tellPlace(event) {
    const s = this.scale ?? this.fitScale();
    const box = this.box.getBoundingClientRect();
    const x = Math.floor((event.clientX - box.left - this.x) / s);
    const y = Math.floor((event.clientY - box.top - this.y) / s);
    const inside = x >= 0 && y >= 0 && x < this.image.naturalWidth && y < this.image.naturalHeight;
    document.getElementById("place").textContent =
      inside ? "pixel " + (x + this.origin[0]) + "," + (y + this.origin[1]) : "";
  },

  start() {
    const box = this.box;
    const at = (e) => [e.clientX - box.getBoundingClientRect().left, e.clientY - box.getBoundingClientRect().top];
    this.image.addEventListener("load", () => this.place());
    new ResizeObserver(() => this.place()).observe(box);
    box.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoomBy(Math.exp(-e.deltaY / 300), ...at(e));
    }, { passive: false });
    box.addEventListener("pointerdown", (e) => box.setPointerCapture(e.pointerId));
    box.addEventListener("pointermove", (e) => {
      if (e.buttons & 1) this.move(e.movementX, e.movementY);
      this.tellPlace(e);
    });
    box.addEventListener("keydown", (e) => {
      const step = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[e.key];
      if (!step || e.ctrlKey || e.metaKey || e.altKey) return;
      e.preventDefault();
      this.move(...step);
    });
    document.getElementById("fit").addEventListener("click", () => this.fit());
    document.getElementById("actual").addEventListener("click", () => this.zoomTo(1));
    document.getElementById("zoom-in").addEventListener("click", () => this.zoomBy(1.5));
    document.getElementById("zoom-out").addEventListener("click", () => this.zoomBy(1 / 1.5));
  },
};
viewer.start();
