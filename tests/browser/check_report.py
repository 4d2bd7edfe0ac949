#!/usr/bin/env python3
"""Opens a report of `evaluate` in headless Chromium.

    python3 tests/browser/check_report.py REPORT_FOLDER

scripts/check_report calls it. Checks that the page loads without a message on the console, that every file in figures/ is
a figure of the page, and that every figure is laid out with nothing cut off: no text outside its drawing, no drawing
outside its page.
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

# Shows the report in a frame and writes down how it was laid out, where --dump-dom can read it.
FRAME = """<!DOCTYPE html><meta charset="utf-8"><pre id="found">the report did not load</pre>
<iframe src="%s" width="1200" height="800"></iframe>
<script>
  document.querySelector("iframe").addEventListener("load", event => {
    const page = event.target.contentDocument;
    const figures = [...page.querySelectorAll("figure")].map(figure => {
      const drawing = figure.querySelector("svg");
      const box = drawing ? drawing.getBoundingClientRect() : {width: 0, height: 0};
      const outside = element => {
        const inner = element.getBoundingClientRect();
        return inner.left < box.left - 1 || inner.right > box.right + 1
          || inner.top < box.top - 1 || inner.bottom > box.bottom + 1;
      };
      const texts = drawing ? [...drawing.querySelectorAll("text")] : [];
      return {
        name: figure.id.replace(/^figure-/, ""),
        width: box.width,
        height: box.height,
        right: box.right,
        texts: texts.length,
        cut: texts.filter(outside).map(text => text.textContent),
      };
    });
    const found = {title: page.title, width: page.documentElement.clientWidth, figures};
    document.getElementById("found").textContent = JSON.stringify(found);
  });
</script>"""


def chromium(page):
    """The page's document after it has run, and what Chromium said on its console."""
    with tempfile.TemporaryDirectory() as profile:
        command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files",
                   f"--user-data-dir={profile}", "--enable-logging=stderr", "--virtual-time-budget=10000", "--dump-dom",
                   page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"chromium: {done.stderr[-2000:]}"
    return done.stdout, [line for line in done.stderr.splitlines() if ":CONSOLE" in line]


def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    page = folder / "report.html"
    with tempfile.TemporaryDirectory() as scratch:
        frame = pathlib.Path(scratch) / "frame.html"
        frame.write_text(FRAME % page.as_uri())
        document, console = chromium(frame)
    assert not console, "\n".join(console)
    text = re.search(r'<pre id="found">(.*?)</pre>', document, re.DOTALL).group(1)
    assert text.startswith("{"), text
    found = json.loads(text.replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">"))

    shown = {figure["name"] for figure in found["figures"]}
    expected = {file.stem for file in (folder / "figures").glob("*.svg")}
    assert shown == expected and shown, f"shown {sorted(shown)}, expected {sorted(expected)}"
    for figure in found["figures"]:
        assert figure["width"] > 300 and figure["height"] > 100 and figure["texts"] > 3, figure
        assert not figure["cut"], f"{figure['name']}: outside of the drawing: {figure['cut']}"
        assert figure["right"] <= found["width"] + 1, f"{figure['name']} is wider than the page: {figure}"
    print(f"{page}: “{found['title']}”, {len(shown)} figures, nothing cut off, nothing on the console")


main()
