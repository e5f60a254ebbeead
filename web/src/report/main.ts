// The page of a report: draws each figure when it comes into view, all of them before printing.

import { redrawAll } from "../drawing/canvas";
import { themeChanged } from "../drawing/colours";
import { drawCellErrors } from "./cells";
import { drawConvergence } from "./convergence";
import { make } from "./elements";
import type { DatasetSignals, Figure } from "./figures";
import { drawAutocorrelation, drawHistograms, drawScatter } from "./fit";
import { drawParameter } from "./parameter";
import { drawStrip } from "./strip";
import { drawProposal } from "./term";
import "./report.css";

const AHEAD = 600; // pixels below the window that are drawn already

function drawFigure(host: HTMLElement, figure: Figure): void {
  switch (figure.kind) {
    case "strip":
      return drawStrip(host, figure, signals[figure.dataset]);
    case "scatter":
      return drawScatter(host, figure);
    case "histograms":
      return drawHistograms(host, figure);
    case "autocorrelation":
      return drawAutocorrelation(host, figure);
    case "convergence":
      return drawConvergence(host, figure);
    case "cells":
      return drawCellErrors(host, figure);
    case "parameter":
      return drawParameter(host, figure);
    case "term":
      return drawProposal(host, figure);
  }
}

const hosts = Array.from(document.querySelectorAll<HTMLElement>("[data-figure]"));
interface ReportData {
  figures: Figure[];
  signals: Record<string, DatasetSignals>;
}
const { figures, signals } = JSON.parse(document.getElementById("report-data")!.textContent) as ReportData;
const drawn = new Set<HTMLElement>();

function draw(host: HTMLElement): void {
  if (drawn.has(host) || host.clientWidth < 40) return;
  drawn.add(host);
  try {
    drawFigure(host, figures[Number(host.dataset.figure)]!);
    host.dataset.drawn = "yes";
  } catch (error) {
    host.dataset.failed = (error as Error).stack ?? "";
    host.append(make("p", { class: "note" }, `This figure could not be drawn: ${(error as Error).message}`));
  }
}

const dark = matchMedia("(prefers-color-scheme: dark)");

function setTheme(name: "light" | "dark"): void {
  if (document.documentElement.dataset.theme === name) return;
  document.documentElement.dataset.theme = name;
  themeChanged();
  redrawAll();
}

function drawWhatIsSeen(): void {
  const seen = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) if (entry.isIntersecting) draw(entry.target as HTMLElement);
    },
    { rootMargin: `${AHEAD}px` },
  );
  for (const host of hosts) {
    seen.observe(host);
    if (host.getBoundingClientRect().top < innerHeight + AHEAD) draw(host);
  }
  document.addEventListener(
    "toggle",
    (event) => {
      const part = event.target as HTMLDetailsElement;
      if (!part.open) return;
      for (const host of part.querySelectorAll("[data-figure]")) {
        seen.unobserve(host);
        seen.observe(host);
      }
    },
    true,
  );
}

/** Paper is white, and shows what is folded. */
function prepareForPrint(): void {
  const opened: HTMLDetailsElement[] = [];
  addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll<HTMLDetailsElement>("details:not([open])")) {
      part.open = true;
      opened.push(part);
    }
    setTheme("light");
    hosts.forEach(draw);
  });
  addEventListener("afterprint", () => {
    for (const part of opened.splice(0)) part.open = false;
    setTheme(dark.matches ? "dark" : "light");
  });
}

/** Unfold what the address points at. */
function reveal(): void {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (target === null) return;
  for (let node: HTMLElement | null = target; node; node = node.parentElement)
    if (node instanceof HTMLDetailsElement) node.open = true;
  [...target.querySelectorAll<HTMLElement>("[data-figure]")].slice(0, 4).forEach(draw);
  target.scrollIntoView();
}

function followLinks(): void {
  addEventListener("hashchange", reveal);
  for (const link of document.querySelectorAll('a[href^="#"]'))
    link.addEventListener("click", () => setTimeout(reveal));
  if (location.hash) reveal();
}

/** Mark the section that is read in the table of contents. */
function markCurrentSection(): void {
  const links = new Map(
    [...document.querySelectorAll<HTMLAnchorElement>("nav a")].map((link) => [link.hash.slice(1), link]),
  );
  const current = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        for (const link of links.values()) link.classList.remove("current");
        links.get(entry.target.id)?.classList.add("current");
      }
    },
    { rootMargin: "-10% 0px -80% 0px" },
  );
  for (const part of document.querySelectorAll("main section, main details[id]"))
    if (links.has(part.id)) current.observe(part);
}

setTheme(dark.matches ? "dark" : "light");
dark.addEventListener("change", () => setTheme(dark.matches ? "dark" : "light"));
drawWhatIsSeen();
prepareForPrint();
followLinks();
markCurrentSection();
document.documentElement.dataset.ready = "yes";
