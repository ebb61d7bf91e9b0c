"""The studio's page: its frame and its style, around the tabs."""

from __future__ import annotations

import panel as pn

TITLE = "emps-design studio"

STYLE = """
body { margin: 0; background: #f5f7fa; color: #1a1a1a;
  font-family: "Segoe UI", "Noto Sans", "Liberation Sans", "DejaVu Sans", Arial, sans-serif; }
header.studio { background: #003a5d; color: #fff; padding: 7px 16px; font-size: 17px; font-weight: 600; }
header.studio small { font-weight: 400; margin-left: 12px; opacity: .9; }
main.studio { padding: 6px 10px 16px; }
"""

# What Bokeh leaves without a name or out of a key's reach: handles of sliders, figures, downloads.
SCRIPT = """
function nameAndReach(root) {
  for (const element of root.querySelectorAll('*')) {
    if (element.shadowRoot) nameAndReach(element.shadowRoot);
  }
  const title = root.querySelector('.bk-slider-title');
  if (title) for (const handle of root.querySelectorAll('.noUi-handle')) {
    const name = title.textContent.trim().replace(/:$/, '');
    if (handle.getAttribute('aria-label') !== name) handle.setAttribute('aria-label', name);
  }
  for (const button of root.querySelectorAll('.bk-spin-btn:not([aria-label])')) {
    button.setAttribute('aria-label', button.classList.contains('bk-spin-btn-up') ? 'more' : 'less');
    button.tabIndex = -1;  // the arrow keys in the field do the same
  }
  for (const layer of root.querySelectorAll('.bk-events[tabindex]:not([aria-label])')) {
    const figure = root.host.getRootNode().host;
    layer.setAttribute('role', 'img');
    layer.setAttribute('aria-label', figure.getAttribute('aria-label') || 'Figure');
  }
  for (const link of root.querySelectorAll('button > a:not([data-reached])')) {
    link.dataset.reached = true;  // a download listens on the words of its button only, which no key reaches
    link.parentElement.addEventListener('click', event => { if (event.target !== link) link.click(); });
  }
  for (const input of root.querySelectorAll('input[type=file]')) {
    if (!input.getAttribute('aria-label') && !input.id) input.setAttribute('aria-label', 'File');
  }
}
setInterval(() => nameAndReach(document), 700);
"""

TEMPLATE = (
    """
{% extends base %}
{% block title %}emps-design studio{% endblock %}
{% block postamble %}<style>"""
    + STYLE
    + """</style><script>"""
    + SCRIPT
    + """</script>{% endblock %}
{% block contents %}
<header class="studio">emps-design studio
<small>design, simulate, compare with the record; everything stays on this machine</small></header>
<main class="studio">{{ embed(roots.studio) }}</main>
{% endblock %}
"""
)


def prepare() -> None:
    """Tell Panel what the page needs; everything is served from this machine."""
    pn.extension("filedropper", inline=False, notifications=False)


def page(root: pn.viewable.Viewable) -> pn.Template:
    """Put ``root`` into the frame."""
    template = pn.Template(TEMPLATE)
    template.add_panel("studio", root)
    return template
