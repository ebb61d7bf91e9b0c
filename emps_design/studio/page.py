"""The studio's page: its frame and style, and the three tabs with the files tab beside them."""

from __future__ import annotations

import panel as pn

TITLE = "emps-design studio"
MAX_UPLOAD_MB = 100

STYLE = """
body { margin: 0; background: #f5f7fa; color: #1a1a1a;
  font-family: "Segoe UI", "Noto Sans", "Liberation Sans", "DejaVu Sans", Arial, sans-serif; }
header.studio { background: #003a5d; color: #fff; padding: 7px 16px; font-size: 17px; font-weight: 600; }
header.studio small { font-weight: 400; margin-left: 12px; opacity: .9; }
main.studio { padding: 6px 10px 16px; }
"""

# Bokeh's sliders carry their name beside the handle; say it on the handle too, for screen readers and keyboards.
SCRIPT = """
function nameHandles(root) {
  for (const element of root.querySelectorAll('*')) {
    if (element.shadowRoot) nameHandles(element.shadowRoot);
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
  for (const input of root.querySelectorAll('input[type=file]')) {
    if (!input.getAttribute('aria-label') && !input.id) input.setAttribute('aria-label', 'File');
  }
}
setInterval(() => nameHandles(document), 700);
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
