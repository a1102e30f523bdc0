"""Style sheet of the report's page; every rule stays inside the report."""

STYLE = """
.vbjfa{--ink:#1c2430;--soft:#5b6675;--line:#dde2e9;--card:#fff;--page:#f5f7fa;
--before:#a9b2bf;--after:#1f6feb;--floor:#f0b429;--good:#1a7f4b;--warn:#b45309;
--bad:#c2273b;color:var(--ink);background:var(--page);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;
padding:clamp(12px,3vw,32px);text-align:left}
@media (prefers-color-scheme:dark){.vbjfa{--ink:#e6eaf0;--soft:#9aa6b5;
--line:#333c48;--card:#1b212a;--page:#12161c;--before:#67717f;--after:#58a6ff;
--floor:#c9971c;--good:#4ac585;--warn:#e8a33d;--bad:#ff7b88}}
.vbjfa *{box-sizing:border-box}
.vbjfa main{max-width:1080px;margin:0 auto}
.vbjfa header{background:var(--card);border:1px solid var(--line);
border-left:6px solid var(--soft);border-radius:10px;padding:16px 20px}
.vbjfa header.good{border-left-color:var(--good)}
.vbjfa header.warn{border-left-color:var(--warn)}
.vbjfa header.bad{border-left-color:var(--bad)}
.vbjfa .kicker{color:var(--soft);font-size:13px;margin:0}
.vbjfa h1{font-size:clamp(18px,2.6vw,23px);line-height:1.35;margin:4px 0 0;
font-weight:650;overflow-wrap:anywhere}
.vbjfa h2{font-size:17px;margin:28px 0 8px;font-weight:650}
.vbjfa p{margin:6px 0}
.vbjfa .note{color:var(--soft);font-size:13px}
.vbjfa .card{background:var(--card);border:1px solid var(--line);border-radius:10px;
padding:12px 16px}
.vbjfa .totals{display:flex;flex-wrap:wrap;gap:8px 28px;margin:12px 0 0}
.vbjfa .totals b{display:block;font-size:22px;font-weight:650;
font-variant-numeric:tabular-nums}
.vbjfa .totals span{color:var(--soft);font-size:13px}
.vbjfa .joint{display:grid;grid-template-columns:minmax(80px,140px) 1fr 180px;
gap:4px 16px;align-items:center;padding:9px 0;border-bottom:1px solid var(--line)}
.vbjfa .joint:last-child{border-bottom:0}
.vbjfa .joint b{overflow-wrap:anywhere;font-weight:600}
.vbjfa .bars{position:relative;min-width:0}
.vbjfa .bar{display:grid;grid-template-columns:1fr 132px;gap:10px;align-items:center;
font-size:13px;font-variant-numeric:tabular-nums}
.vbjfa .track{position:relative;height:9px}
.vbjfa .fill{position:absolute;inset:0 auto 0 0;border-radius:2px;min-width:2px}
.vbjfa .fill.before{background:var(--before)}
.vbjfa .fill.after{background:var(--after)}
.vbjfa .range{position:absolute;top:3px;height:3px;background:var(--ink);opacity:.55}
.vbjfa .tick{position:absolute;top:-3px;bottom:-3px;width:2px;background:var(--floor)}
.vbjfa .key{display:inline-block;width:12px;height:9px;border-radius:2px;
margin:0 5px 0 12px}
.vbjfa .key:first-child{margin-left:0}
.vbjfa .good-text{color:var(--good)}
.vbjfa .warn-text{color:var(--warn)}
.vbjfa .bad-text{color:var(--bad);font-weight:600}
.vbjfa .scroll{overflow-x:auto}
.vbjfa table{border-collapse:collapse;width:100%;font-size:14px;background:none}
.vbjfa th,.vbjfa td{text-align:left;padding:7px 14px 7px 0;vertical-align:top;
border-bottom:1px solid var(--line);background:none;color:inherit}
.vbjfa tr:last-child td{border-bottom:0}
.vbjfa th{color:var(--soft);font-weight:500;font-size:13px}
.vbjfa td.n{font-variant-numeric:tabular-nums;white-space:nowrap}
.vbjfa td.name{min-width:5.5em;max-width:16em;overflow-wrap:anywhere}
.vbjfa ul{margin:6px 0;padding-left:20px}
.vbjfa .pictures{display:grid;gap:12px;
grid-template-columns:repeat(auto-fill,minmax(min(100%,300px),1fr))}
.vbjfa figure{margin:0;background:var(--card);border:1px solid var(--line);
border-radius:10px;padding:10px 12px}
.vbjfa figcaption{display:flex;justify-content:space-between;gap:8px;font-size:13px}
.vbjfa figcaption span{color:var(--soft);white-space:nowrap}
.vbjfa svg{display:block;width:100%;height:110px;margin-top:6px}
.vbjfa svg path,.vbjfa svg rect{vector-effect:non-scaling-stroke}
.vbjfa .line{fill:none;stroke-width:1.2}
.vbjfa .line.before{stroke:var(--before)}
.vbjfa .line.after{stroke:var(--after)}
.vbjfa .area.before{fill:var(--before)}
.vbjfa .area.after{fill:var(--after);fill-opacity:.85}
.vbjfa .floor{fill:var(--floor);fill-opacity:.3}
.vbjfa .axis{position:relative;height:16px;margin-top:2px;color:var(--soft);
font-size:11px;line-height:16px;font-variant-numeric:tabular-nums}
.vbjfa .axis span{position:absolute;white-space:nowrap;transform:translateX(-50%)}
.vbjfa .axis span:first-child{transform:none}
.vbjfa .axis span:last-child{transform:translateX(-100%)}
.vbjfa .causes{color:var(--bad);margin:12px 0 0}
.vbjfa .zero{stroke:var(--soft);stroke-width:.6;fill:none}
.vbjfa details{margin:8px 0}
.vbjfa summary{cursor:pointer;color:var(--soft)}
.vbjfa dl{display:grid;grid-template-columns:max-content 1fr;gap:4px 16px;margin:0;
font-size:14px}
.vbjfa dt{color:var(--soft)}
.vbjfa dd{margin:0;overflow-wrap:anywhere}
@media (max-width:760px){.vbjfa .joint{grid-template-columns:1fr}
.vbjfa .bar{grid-template-columns:1fr 148px}
.vbjfa table.stack,.vbjfa .stack tbody,.vbjfa .stack tr,.vbjfa .stack td{display:block}
.vbjfa .stack thead{display:none}
.vbjfa .stack tr{padding:8px 0;border-bottom:1px solid var(--line)}
.vbjfa .stack tr:last-child{border-bottom:0}
.vbjfa .stack td{border:0;padding:1px 0;white-space:normal;max-width:none}
.vbjfa .stack td[data-name]:not(:empty)::before{content:attr(data-name) ": ";
color:var(--soft)}
.vbjfa dl{grid-template-columns:1fr}.vbjfa dd{margin-bottom:4px}}
"""
