"use strict";
(() => {
  const dialog = document.getElementById("large"), stage = dialog.querySelector(".stage");
  const large = dialog.querySelector("img"), words = dialog.querySelector("p");
  const buttons = [...document.querySelectorAll(".zoom")];
  let shown = 0;

  function show(number) {
    shown = (number + buttons.length) % buttons.length;
    const image = buttons[shown].querySelector("img");
    large.src = image.src;
    large.alt = words.textContent = image.alt;
    stage.classList.remove("actual");
    if (!dialog.open) dialog.showModal();
  }
  buttons.forEach((button, number) => button.addEventListener("click", () => show(number)));
  large.addEventListener("click", () => stage.classList.toggle("actual"));
  stage.addEventListener("click", event => { if (event.target === stage) dialog.close(); });
  dialog.addEventListener("click", event => {
    const button = event.target.closest("button");
    if (button && button.dataset.step) show(shown + Number(button.dataset.step));
    else if (button) dialog.close();
  });
  dialog.addEventListener("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step && !stage.classList.contains("actual")) show(shown + step);
  });

  // a film is a sheet of its frames: one of them is shown at a time, and a slider goes through them
  for (const figure of document.querySelectorAll(".film")) {
    const { frames, columns, rows, times } = figure.dataset, image = figure.querySelector("img");
    const seconds = times.split(" "), player = document.createElement("div");
    const play = document.createElement("button"), slider = document.createElement("input"), time = document.createElement("span");
    let timer = 0;
    figure.style.setProperty("--columns", columns);
    figure.style.setProperty("--shape", (image.getAttribute("width") / columns) / (image.getAttribute("height") / rows));
    player.className = "player";
    play.type = "button";
    Object.assign(slider, { type: "range", min: 0, max: frames - 1, value: Math.floor(frames / 2) });
    slider.setAttribute("aria-label", "frame");
    function at() {
      const frame = Number(slider.value);
      figure.style.setProperty("--left", `${-100 / columns * (frame % columns)}%`);
      figure.style.setProperty("--top", `${-100 / rows * Math.floor(frame / columns)}%`);
      time.textContent = `${seconds[frame]} s`;
    }
    function stop() {
      clearInterval(timer);
      timer = 0;
      play.textContent = "▶";
      play.setAttribute("aria-label", "play");
    }
    play.addEventListener("click", () => {
      if (timer) return stop();
      play.textContent = "❚❚";
      play.setAttribute("aria-label", "pause");
      timer = setInterval(() => { slider.value = (Number(slider.value) + 1) % frames; at(); }, 160);
    });
    slider.addEventListener("input", () => { stop(); at(); });
    player.append(play, slider, time);
    figure.insertBefore(player, figure.querySelector("figcaption"));
    figure.classList.add("live");
    stop();
    at();
  }

  addEventListener("beforeprint", () => document.querySelectorAll("img").forEach(image => { image.loading = "eager"; }));
})();
