"""Known vulnerabilities of a set of pinned packages, by pip-audit; what cannot be looked up is said, and no failure."""

import json
import subprocess
import sys


def main(pinned: str) -> int:
    """Audit the packages in the file ``pinned``; 1 where one of them is vulnerable."""
    command = [sys.executable, "-m", "pip_audit", "-r", pinned, "--no-deps", "--disable-pip", "--format", "json"]
    done = subprocess.run([*command, "--progress-spinner", "off", "--timeout", "10"], capture_output=True, text=True)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError):
        why = (done.stderr.strip().splitlines() or ["no answer"])[-1]
        print(f"audit: not done, the vulnerability database could not be asked ({why[:200]})")
        return 0
    skipped = [one for one in packages if "skip_reason" in one]
    if len(skipped) == len(packages):
        print(f"audit: not done, none of {len(packages)} packages could be looked up ({skipped[0]['skip_reason']})")
        return 0
    found = [(one, problem) for one in packages for problem in one.get("vulns", ())]
    for one, problem in found:
        fixed = ", ".join(problem["fix_versions"]) or "no version yet"
        print(f"audit: {one['name']} {one['version']}: {problem['id']}, fixed in {fixed}")
    told = f"; {len(skipped)} more could not be looked up" if skipped else ""
    print(f"audit: {len(found)} known vulnerabilities in {len(packages) - len(skipped)} packages{told}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
