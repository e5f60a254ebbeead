"""The signal flow of demos as the app draws it on the screen Function; `loops.py` has that of the idle demo."""

import re
import shutil
import tempfile
from pathlib import Path

from scripts.pictures import demos
from scripts.pictures.browser import READY, open_app
from scripts.pictures.drawing import write

MARGIN = 8  # pixels
WIDE = {"width": 2400, "height": 900}  # room for all columns side by side
# copies the picture with the styles that the page gives to its elements; names that are too long are set tighter
EXTRACT = """
svg => {
  const kept = ["fill", "stroke", "stroke-width", "font-size", "font-weight", "text-anchor"];
  const copy = svg.cloneNode(true);
  const [own, copied] = [svg, copy].map((each) => [...each.querySelectorAll("rect, path, text")]);
  own.forEach((element, i) => {
    const style = getComputedStyle(element);
    copied[i].setAttribute("style", kept.map((name) => `${name}: ${style.getPropertyValue(name)}`).join("; "));
    const room = Number(element.parentElement.querySelector("rect")?.getAttribute("width")) - 14;
    if (element.matches(".t1") && element.getComputedTextLength() > room - 4) {
      copied[i].textContent = element.parentElement.dataset.node;
      copied[i].setAttribute("textLength", String(room));
      copied[i].setAttribute("lengthAdjust", "spacingAndGlyphs");
    }
  });
  for (const element of copy.querySelectorAll("*"))
    for (const name of ["class", "role", "tabindex", "data-node", "aria-label"]) element.removeAttribute(name);
  const { width, height } = svg.viewBox.baseVal;
  return [new XMLSerializer().serializeToString(copy), width, height];
}
"""


def make() -> None:
    """Draw the signal flow of each demo, with the values of a sample."""
    for name in ("torque", "exhaust"):
        with tempfile.TemporaryDirectory() as folder:
            project = Path(shutil.copytree(demos.folder(name), Path(folder) / name)) / "kennfeld.toml"
            with open_app(project) as page:
                page.set_viewport_size(WIDE)
                page.click("#run")
                page.wait_for_selector("#job-state.converged", timeout=120_000)
                page.click("[data-screen=function]")
                page.wait_for_timeout(1200)
                page.wait_for_selector(READY)
                content, width, height = page.eval_on_selector("svg.flow", EXTRACT)
        write(f"flow-{name}", frame(content, width, height))


def frame(svg: str, width: float, height: float) -> str:
    """Return the picture on white, with a margin."""
    content = re.sub(r"^<svg[^>]*>|</svg>$", "", svg)
    across, up = width + 2 * MARGIN, height + 2 * MARGIN
    size = f'width="{across:g}" height="{up:g}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{-MARGIN} {-MARGIN} {across:g} {up:g}" {size}'
    ground = f'<rect x="{-MARGIN}" y="{-MARGIN}" {size} fill="white"/>'
    return f"{head} font-family=\"'DejaVu Sans'\">{ground}\n{content}</svg>"
