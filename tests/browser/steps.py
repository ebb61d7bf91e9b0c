"""What tests of the page do with it, each step as often as it is needed."""

BUSY = 120_000  # ms in which a machine that does other things as well answers


def sampled_margin(page) -> str:
    """The phase margin on the drive that the page shows."""
    return page.locator("b.margin").first.inner_text()


def wait_for_change(page, before: str) -> None:
    """Wait until the page shows another margin than ``before``."""
    from playwright.sync_api import expect

    expect(page.locator("b.margin").first).not_to_have_text(before, timeout=BUSY)


def wait_for_value(field, value: str) -> None:
    """Wait until ``field`` holds ``value``: a machine that is busy takes its time to put a number back."""
    from playwright.sync_api import expect

    expect(field).to_have_value(value, timeout=BUSY)


def turn_to(page, tab: str) -> None:
    page.get_by_role("button", name=tab, exact=True).click()


def type_into(page, label: str, value: str) -> None:
    field = page.get_by_label(label, exact=True).locator("visible=true").first
    field.fill(value)
    field.press("Enter")


def upload(page, path) -> None:
    page.locator(".filepond--browser").first.set_input_files(str(path))
