"""The page of a diagnosis with its sections."""

from collections.abc import Mapping

from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis.ladder import ladder_section
from hil_forceps.report.diagnosis.sections import (
    audit,
    candidates,
    gains,
    how,
    minimum_detectable,
    next_experiment,
    shifts,
    tied,
    trends,
    verdict,
)
from hil_forceps.report.diagnosis.words import escaped

# Styles and images are embedded; no scripts, no external addresses.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"

Images = Mapping[str, str]  # figures by name, as HTML


def page(diagnosis: Diagnosis, images: Images) -> str:
    """Return the page; empty sections are left out."""
    residuals = "".join(image for name, image in images.items() if name.startswith("residual_"))
    sections = (
        ("Measured against simulated", images.get("measured_simulated", "")),
        ("Residuals", residuals + trends(diagnosis)),
        ("Loops", images.get("loops", "")),
        ("Spectra", images.get("spectra", "")),
        ("Lack of fit by balance", images.get("balances", "")),
        ("Candidates and their evidence", images.get("candidates", "") + candidates(diagnosis)),
        ("The ladder", ladder_section(diagnosis, images.get("ladder", ""))),
        ("Parameters", images.get("parameters", "") + shifts(diagnosis)),
        ("Models that can't be distinguished", tied(diagnosis)),
        (
            "Errors on runs held out, before and after",
            gains(diagnosis, images.get("gain", "")) + images.get("held_out", ""),
        ),
        ("Estimates before and after", images.get("estimates", "")),
        ("Detectable effects", minimum_detectable(diagnosis)),
        ("The data", audit(diagnosis)),
        ("Next experiment", next_experiment(diagnosis)),
        ("Method", how()),
    )
    shown = [(title, body) for title, body in sections if body]
    contents = "".join(f'<a href="#s{place}">{escaped(title)}</a>' for place, (title, _) in enumerate(shown, 1))
    body = "".join(
        f'<section id="s{place}"><h2>{escaped(title)}</h2>{content}</section>'
        for place, (title, content) in enumerate(shown, 1)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Diagnosis: {escaped(diagnosis.verdict)}</title><style>{STYLE}</style></head>\n"
        f"<body><main>{verdict(diagnosis)}<nav>{contents}</nav>{body}"
        "<footer>hil-forceps. Not a medical device.</footer></main></body></html>\n"
    )


STYLE = """
:root{--ink:#1c1c1e;--soft:#5b5b60;--paper:#fff;--line:#d9d9de;--tint:#f5f5f7;--accent:#0072b2}
@media(prefers-color-scheme:dark){:root{--ink:#e8e8ea;--soft:#a5a5ab;--paper:#17181a;--line:#3a3b3f;--tint:#232427;
--accent:#6cb8e6}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 Charter,"Bitstream Charter",Georgia,serif}
main{max-width:58rem;margin:0 auto;padding:1.5rem 1.2rem 4rem}
h1{font-size:1.6rem;line-height:1.25;margin:.2rem 0 .6rem}
h2{font-size:1.2rem;margin:2.4rem 0 .6rem;border-bottom:1px solid var(--line);padding-bottom:.2rem}
h3{font-size:1rem;margin:1.2rem 0 .3rem}
p{max-width:44rem}
nav{display:flex;flex-wrap:wrap;gap:.2rem 1rem;font-size:.85rem;margin:1rem 0}
a{color:var(--accent)}
.verdict{border-left:.4rem solid var(--mark);padding:.2rem 0 .2rem 1rem}
.kind{font-size:.8rem;letter-spacing:.06em;text-transform:uppercase;color:var(--soft)}
.consistent{--mark:#009e73}.parameters{--mark:#e69f00}.effects{--mark:#0072b2}.unnamed{--mark:#cc79a7}
.undetermined{--mark:#8a8a90}
.card{background:var(--tint);border:1px solid var(--line);border-radius:.4rem;padding:.6rem 1rem;margin:.8rem 0}
.card h3{margin-top:.2rem}
.eq{font-style:italic;display:block;margin:.4rem 0;padding-left:1rem}
.note{color:var(--soft);font-size:.85rem}
code{font:.85em ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace}
figure{margin:1rem 0}
figure img{display:block;width:100%;height:auto;background:#fff;border-radius:.3rem;padding:.3rem}
figcaption{font-size:.85rem;color:var(--soft);margin-top:.3rem;max-width:50rem}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.85rem;margin:.6rem 0;min-width:50%}
th,td{text-align:left;padding:.25rem .8rem .25rem 0;border-bottom:1px solid var(--line);vertical-align:top}
th{font-weight:600}
sub,sup{line-height:0}
.chain{padding-left:1.2rem}
.r{text-align:right;font-variant-numeric:tabular-nums}
.n{white-space:nowrap}
.problem{color:#c0392b;font-weight:600}.warning{color:#b7791f;font-weight:600}
footer{margin-top:3rem;font-size:.8rem;color:var(--soft)}
@media print{:root{--ink:#000;--soft:#444;--paper:#fff;--line:#bbb;--tint:#fff}body{font-size:10pt}
main{max-width:none;padding:0}nav{display:none}figure,.card,tr{break-inside:avoid}h2,h3{break-after:avoid}
figure img{padding:0}@page{size:A4;margin:16mm}}
"""
