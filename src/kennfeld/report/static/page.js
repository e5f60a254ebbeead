"use strict";
// Draws each picture when it comes into view, all of them before printing.

(() => {
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const drawn = new Set();
  const draw = (host) => {
    if (drawn.has(host) || host.clientWidth < 40) return;
    drawn.add(host);
    const figure = data.figures[Number(host.dataset.figure)];
    try {
      DRAW[figure.kind](host, figure);
      host.dataset.drawn = "yes";
    } catch (error) {
      host.dataset.failed = error.stack;
      host.textContent = `This figure could not be drawn: ${error.message}`;
    }
  };
  const hosts = [...document.querySelectorAll("[data-figure]")];
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
  }, { rootMargin: "600px" });
  for (const host of hosts) {
    seen.observe(host);
    if (host.getBoundingClientRect().top < window.innerHeight + 600) draw(host);
  }

  document.addEventListener("toggle", (event) => {
    if (event.target.open) for (const host of event.target.querySelectorAll("[data-figure]")) seen.unobserve(host), seen.observe(host);
  }, true);

  const opened = [];
  window.addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll("details:not([open])")) { part.open = true; opened.push(part); }
    hosts.forEach(draw);
  });
  window.addEventListener("afterprint", () => { for (const part of opened.splice(0)) part.open = false; });

  const reveal = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let node = target; node; node = node.parentElement) if (node.tagName === "DETAILS") node.open = true;
    target.querySelectorAll("[data-figure]").forEach((host, i) => { if (i < 4) draw(host); });
    target.scrollIntoView();
  };
  window.addEventListener("hashchange", reveal);
  for (const link of document.querySelectorAll('a[href^="#"]')) link.addEventListener("click", () => setTimeout(reveal));
  if (location.hash) reveal();

  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const current = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      for (const link of links.values()) link.classList.remove("current");
      links.get(entry.target.id)?.classList.add("current");
    }
  }, { rootMargin: "-10% 0px -80% 0px" });
  document.querySelectorAll("main section, main details[id]").forEach((part) => { if (links.has(part.id)) current.observe(part); });
  document.documentElement.dataset.ready = "yes";
})();
