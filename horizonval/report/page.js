"use strict";
(() => {
  const find = (id) => document.getElementById(id);
  const grid = find("grid"), dialog = find("large"), stage = find("stage");
  const tiles = [...grid.querySelectorAll(".tile")];
  const results = new Map(tiles.map((tile) => [tile, JSON.parse(tile.dataset.results)]));
  const [estimator, status, camera, order] = ["estimator", "status", "camera", "order"].map(find);
  let open = null;

  const shown = () => [...grid.querySelectorAll(".tile:not([hidden])")];
  const result = (tile) => results.get(tile)[estimator.value] ?? ["none", null];

  const showLayer = (root) => {
    for (const layer of root.querySelectorAll(".layer")) {
      layer.classList.toggle("on", Number(layer.dataset.layer) === estimator.selectedIndex);
    }
  };

  const update = () => {
    const sign = order.value === "best" ? 1 : -1;
    const sorted = [...tiles].sort((a, b) => {
      const first = Number(a.dataset.index) - Number(b.dataset.index);
      if (order.value === "suite") return first;
      // Frames without an error have no place in this order and stand last.
      const [x, y] = [result(a)[1], result(b)[1]];
      if (x === null || y === null) return (x === null) - (y === null) || first;
      return sign * (x - y) || first;
    });
    for (const tile of sorted) {
      tile.hidden = Boolean((status.value && result(tile)[0] !== status.value) || (camera.value && tile.dataset.camera !== camera.value));
      grid.append(tile);
    }
    const n = shown().length;
    find("count").textContent = `${n} of ${tiles.length} shown`;
    find("nothing").hidden = n > 0 || tiles.length === 0;
    showLayer(document);
  };

  const enlarge = (tile) => {
    const all = shown(), copy = tile.cloneNode(true);
    open = tile;
    copy.classList.replace("tile", "large");
    copy.querySelector("details").open = true;
    const button = copy.querySelector(".open");
    if (button) {
      const picture = document.createElement("div");
      picture.className = "open";
      picture.append(...button.childNodes);
      button.replaceWith(picture);
    }
    stage.replaceChildren(copy);
    find("place").textContent = `${all.indexOf(tile) + 1} of ${all.length}`;
    if (!dialog.open) dialog.showModal();
    dialog.scrollTop = 0;
  };

  const step = (by) => {
    const all = shown();
    enlarge(all[(all.indexOf(open) + by + all.length) % all.length]);
  };

  for (const select of [estimator, status, camera, order]) select.addEventListener("change", update);
  for (const name of ["truth", "infrared", "points", "limb"]) {
    const box = find(`show-${name}`);
    if (!box) continue;
    const apply = () => document.body.classList.toggle(`hide-${name}`, !box.checked);
    box.addEventListener("change", apply);
    apply();
  }
  grid.addEventListener("click", (event) => {
    const button = event.target.closest(".open");
    if (button) enlarge(button.closest(".tile"));
  });
  find("previous").addEventListener("click", () => step(-1));
  find("next").addEventListener("click", () => step(1));
  find("close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "ArrowLeft") step(-1);
    if (event.key === "ArrowRight") step(1);
  });
  document.querySelector("form.controls").addEventListener("submit", (event) => event.preventDefault());
  update();
})();
