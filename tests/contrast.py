"""Contrast of the text that a browser shows, by WCAG 2.1: 4.5 to 1 is what normal text needs."""

NEEDED = 4.5

_FAINT = """
(() => {
  const parse = c => { const m = c.match(/[\\d.]+/g).map(Number); return m.length < 4 ? [...m, 1] : m; };
  const over = (a, b) => [0, 1, 2].map(i => a[i] * a[3] + b[i] * (1 - a[3])).concat(1);
  const linear = v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const luminance = c => 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
  const ground = e => {
    const layers = [];
    for (; e; e = e.parentElement) {
      layers.push(parse(getComputedStyle(e).backgroundColor));
      if (layers.at(-1)[3] === 1) break;
    }
    return layers.reduceRight((below, above) => over(above, below), [255, 255, 255, 1]);
  };
  const faint = {}, walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let seen = 0;
  while (walk.nextNode()) {
    const text = walk.currentNode.textContent.trim(), e = walk.currentNode.parentElement;
    if (!text || e.closest('script, style, noscript, [hidden], SKIPPED')) continue;
    if (!e.getClientRects().length) continue;
    seen += 1;
    const below = ground(e), colour = over(parse(getComputedStyle(e).color), below);
    const [light, dark] = [luminance(colour), luminance(below)].sort((p, q) => q - p);
    const ratio = (light + 0.05) / (dark + 0.05);
    if (ratio < NEEDED) faint[`${e.tagName}.${e.className}`] = `${ratio.toFixed(2)} of ${text.slice(0, 40)}`;
  }
  return [seen, faint];
})()
"""


def faint_texts(browser, skipped="none"):
    """Return how many texts a page shows, and those too faint to read: element -> contrast and text.

    `skipped` selects what is laid over the page and not shown at first.
    """
    return browser.evaluate(_FAINT.replace("NEEDED", str(NEEDED)).replace("SKIPPED", skipped))


def prefer(browser, scheme):
    """Make a browser ask pages for `light` or `dark`."""
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
