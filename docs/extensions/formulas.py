"""Formulas in plain text, as docstrings have them, in LaTeX: `sqrt(E/(12 rho))`, `theta_tt^2/2`."""

import re

_GREEK = "alpha beta gamma delta eta theta kappa rho sigma tau chi psi omega pi Theta Phi Omega"
SYMBOLS = {name: f"\\{name} " for name in (*_GREEK.split(), "int", "sum")} | {
    "phi": r"\varphi ",
    "eps": r"\varepsilon ",
    "epsilon": r"\varepsilon ",
    "rhoA": r"\rho A",
    "rhoI": r"\rho I",
    "sn": r"\,\mathrm{sn}\,",
    "std": r"\mathrm{std}\,",
    "...": r"\ldots ",
    ".": r"\cdot ",
    ":": r"\colon ",
    "<=": r"\le ",
    ">=": r"\ge ",
}
FUNCTIONS = "sin", "cos", "tan", "cot", "exp", "ln", "max"
BETWEEN = "+", "-", "=", ",", "<", ">", "<=", ">="
BRACKETS = {"(": "()", "[": "[]", "|": "||", "⟨": (r"\langle ", r"\rangle ")}
SHORT_WORDS = "of", "on", "in"
TOKEN = re.compile(r"[A-Za-z]+|\d+(?:\.\d+)?|\.\.\.|[<>]=|\S")


_NAMES = sorted((name for name in (*SYMBOLS, *FUNCTIONS, "sqrt") if name.isalpha()), key=len)
_WORD = rf"D?(?:{'|'.join(_NAMES[::-1])})|[A-Z]{{2}}|[A-Za-z]"
_SYMBOL = rf"(?<![A-Za-z])(?:{_WORD})(?:\d|_\w+)?'*(?![A-Za-z])"
_ATOM = rf"(?:{_SYMBOL}|\d+(?:\.\d+)?(?!\w|\.\d)|[][()|+/^<>,-])"
#: An equation within a line: symbols, an equality sign, and what follows it.
_EQUATION = re.compile(rf"(?<![`\w.])(?:{_SYMBOL}|[<|])(?:\s?{_ATOM})*\s=\s{_ATOM}(?:\s?{_ATOM})*")


def inline(text):
    """A paragraph in Markdown, with its equations as formulas."""
    done, at = "", 0
    while match := _EQUATION.search(text, at):
        found = _balanced(match[0])
        start, at = at, match.start() + max(1, len(found))
        written = f"${latex(found)}$" if "=" in found else match[0][: at - match.start()]
        done += text[start : match.start()] + written
    return done + text[at:]


def _balanced(text):
    """The beginning of a formula, up to where no bracket is open and no sign is without operand."""
    depth, end = 0, len(text)
    for n, sign in enumerate(text):
        depth += (sign in "([") - (sign in ")]")
        if depth < 0 or (not depth and sign == ","):
            end = n
            break
    while end and (
        text[end - 1] in " \n+-/^<>=,|" or text[:end].count("(") != text[:end].count(")")
    ):
        end -= 1
    whole = re.sub(rf"\b(?:sqrt|{'|'.join(FUNCTIONS)})$", "", text[:end])
    return text[:end] if whole == text[:end] else _balanced(whole)


def latex(text):
    """A formula in LaTeX; columns, which two blanks separate, have a space between them."""
    return r"\qquad ".join(_Column(column).latex() for column in re.split(r"\s{2,}", text.strip()))


class _Column:
    """The tokens of a formula, read from left to right."""

    def __init__(self, text):
        ends = text[-1] in ".,;" and text[-3:] != "..."
        text, self.end = (text[:-1], text[-1]) if ends else (text, "")
        # Angle brackets have no blank inside them, while signs of order have blanks around them.
        self.tokens = TOKEN.findall(re.sub(r"<(\S[^<>]*)>", r"⟨\1⟩", text))[::-1]

    def latex(self):
        return self.all() + self.end

    def peek(self):
        return self.tokens[-1] if self.tokens else ""

    def all(self, closing=""):
        """All up to a closing bracket, which goes too: products, and signs between them."""
        parts, product = [], []
        while self.peek() not in ("", closing):
            if self.peek() in BETWEEN or self.words():
                sign = self.words(take=True) or self.tokens.pop()
                parts += [*product, SYMBOLS.get(sign, sign)]
                product = []
            elif self.peek() == "/":
                self.tokens.pop()
                top = _bare(product)
                product = [rf"\frac{{{top}}}{{{_bare([self.factor()])}}}"]
            else:
                product.append(self.factor())
        if self.tokens:
            self.tokens.pop()
        return " ".join(parts + product)

    def factor(self):
        """A symbol, a function or a bracket, with its indices, exponents and primes."""
        token = self.tokens.pop()
        if token in BRACKETS:
            left, right = BRACKETS[token]
            inner = self.all("⟩" if token == "⟨" else right)
            if "\\frac" in inner and token != "|":
                left, right = rf"\left{left}", rf"\right{right}"
            return f"{left}{inner}{right}" + self.attached()
        if token == "sqrt":
            self.tokens.pop()
            return rf"\sqrt{{{self.all(')')}}}" + self.attached()
        if token in FUNCTIONS:
            return f"\\{token}" + self.attached() + " " + self.factor()
        base = SYMBOLS.get(token, token)
        if token[:1] == "D" and token[1:] in SYMBOLS:
            base = rf"\Delta {SYMBOLS[token[1:]]}"
        letter = token in _GREEK.split() or (len(token) == 1 and token.isalpha() and token != "d")
        if letter and self.peek().isdigit():
            base += f"_{{{self.tokens.pop()}}}"  # as in t0
        return base + self.attached()

    def attached(self):
        found = ""
        while self.peek() in ("_", "^", "'"):
            sign = self.tokens.pop()
            token = "" if sign == "'" else self.tokens.pop()
            if token.isalpha() and len(token) > 2 and token not in SYMBOLS:
                token = rf"\mathrm{{{token}}}"
            found += sign + (f"{{{SYMBOLS.get(token, token)}}}" if token else "")
        return found

    def words(self, take=False):
        """Words, which are text and not a product of symbols: letters, and an 's after them."""
        found = []
        for token in reversed(self.tokens):
            known = token in SYMBOLS or token in FUNCTIONS or token == "sqrt"
            word = re.fullmatch("[a-z]{3,}", token) or token in SHORT_WORDS
            if known or not (word or (found and token in "'s")):
                break
            found.append(token)
        if take:
            del self.tokens[len(self.tokens) - len(found) :]
        return rf"\text{{ {' '.join(found)} }}".replace(" ' s", "'s") if found else ""


def _bare(product):
    """A product, without the brackets if it is one pair of them."""
    text = " ".join(product)
    pair = re.fullmatch(r"(?:\\left)?\((.*?)(?:\\right)?\)", text) if len(product) == 1 else None
    return pair[1] if pair else text
