# Reads run tables of designs and prints F, degrees of freedom and p of each effect, as JSON lines.
folder <- commandArgs(TRUE)[1]
options(contrasts = c("contr.sum", "contr.poly"))
tell <- function(name, effect, f, df1, df2, p) {
  cat(sprintf('{"design": "%s", "effect": "%s", "figures": [%.12g, %.12g, %.12g, %.12g]}\n', name, effect, f, df1, df2, p))
}
of_aov <- function(name, fit, effects) {
  for (stratum in summary(fit)) {
    table <- stratum[[1]]
    rownames(table) <- trimws(rownames(table))
    for (effect in intersect(effects, rownames(table))) {
      row <- table[effect, ]
      if (!is.null(row[["F value"]])) {
        tell(name, effect, row[["F value"]], row[["Df"]], table["Residuals", "Df"], row[["Pr(>F)"]])
      }
    }
  }
}
last <- function(name, effect, fit) {
  table <- drop1(fit, effect, test = "F")
  tell(name, sub("~", "", deparse(effect)), table[2, "F value"], table[2, "Df"], fit$df.residual, table[2, "Pr(>F)"])
}
read <- function(name) read.csv(file.path(folder, paste0(name, ".csv")), colClasses = "character")
typed <- function(data) { data$y <- as.numeric(data$y); for (each in setdiff(names(data), "y")) data[[each]] <- factor(data[[each]]); data }

split <- typed(read("split_plot"))
of_aov("split_plot", aov(y ~ Hard * Easy + Error(Plot), split), c("Hard", "Easy", "Hard:Easy"))
blocked <- typed(read("split_plot_in_replicates"))
of_aov("split_plot_in_replicates", aov(y ~ Replicate + Hard * Easy + Error(Plot), blocked), c("Hard", "Easy", "Hard:Easy"))
square <- typed(read("latin_squares"))
last("latin_squares", ~Treatment, lm(y ~ Row + Column + Treatment, square))
carried <- typed(read("crossover"))
sum_coded <- contr.sum(nlevels(carried$Treatment))
before <- read("crossover")$Before
carry <- t(sapply(before, function(each) if (each == "") rep(0, ncol(sum_coded)) else sum_coded[match(each, levels(carried$Treatment)), ]))
# Of four treatments within subjects: with R's own epsilon of what periods leave of each subject's contrasts.
within <- function(name, fit, beside) {
  table <- drop1(fit, ~Treatment, test = "F")
  unit <- contr.helmert(4) %*% diag(1 / sqrt(colSums(contr.helmert(4)^2)))
  of_subjects <- function(x) as.vector(rowsum(unit[carried$Treatment, ] * x, carried$Subject))
  rest <- matrix(qr.resid(qr(apply(beside, 2, of_subjects)), of_subjects(carried$y)), ncol = 3)
  told <- stats:::sphericity(structure(list(SSD = crossprod(rest), df = fit$df.residual / 3), class = "SSD"))
  share <- min(1, told$HF.eps)
  f <- table[2, "F value"]
  tell(name, "Treatment", f, 3 * share, fit$df.residual * share, pf(f, 3 * share, fit$df.residual * share, lower.tail = FALSE))
}
subjects <- lm(y ~ Subject + Period + Treatment, carried)
within("crossover_washed_out", subjects, model.matrix(~ Period + Treatment, carried)[, -1])
within("crossover", lm(y ~ Subject + Period + carry + Treatment, carried), cbind(model.matrix(~ Period + Treatment, carried)[, -1], carry))
last("incomplete", ~Treatment, lm(y ~ Block + Treatment, typed(read("incomplete"))))
single <- typed(read("single_runs"))
for (effect in c("A", "B", "C")) last("single_runs", as.formula(paste0("~", effect)), lm(y ~ A + B + C, single))
surface <- read("surface"); surface[] <- lapply(surface, as.numeric)
full <- lm(y ~ X + Y + I(X^2) + I(Y^2) + X:Y, surface)
without <- lm(y ~ Y + I(Y^2), surface)
table <- anova(without, full)
tell("surface", "X", table[2, "F"], table[2, "Df"], full$df.residual, table[2, "Pr(>F)"])
last("surface", ~X:Y, full)

# Units that tell their response to each of several factors.
two <- typed(read("split_plot_of_two"))
of_aov("split_plot_of_two", aov(y ~ Hard * A * B + Error(Plot / (A * B)), two), c("Hard", "A", "Hard:A"))
three <- typed(read("split_plot_of_three"))
of_aov(
  "split_plot_of_three", aov(y ~ Replicate + (Hard + A + B + C)^3 + Error(Plot / (A * B * C)), three),
  c("Hard", "A", "B", "C", "Hard:A", "Hard:B", "Hard:C", "A:B", "A:C", "B:C", "Hard:A:B", "Hard:A:C", "Hard:B:C", "A:B:C")
)
crossed <- typed(read("crossover_of_two"))
of_aov("crossover_of_two", aov(y ~ Period + A * B + Error(Subject / (A * B)), crossed), c("A", "B", "A:B"))
of_aov("periods_of_each", aov(y ~ Period + A + Error(Subject / A), typed(read("periods_of_each"))), "A")

# Of several contrasts: with the epsilon of Huynh and Feldt, or of Geisser and Greenhouse where plots are few.
wide <- function(data) {
  data <- aggregate(y ~ Plot + Hard + A + B, data, mean)
  data <- data[order(data$Plot, data$A, data$B), ]
  plots <- data[!duplicated(data$Plot), ]
  list(fit = lm(matrix(data$y, nrow(plots), byrow = TRUE) ~ plots$Hard), cells = data[data$Plot == data$Plot[1], c("A", "B")])
}
corrected <- function(name, data, which) {
  of <- wide(data)
  for (effect in c("B", "A:B")) {
    inner <- if (effect == "B") ~A else ~ A + B
    outer <- if (effect == "B") ~ A + B else ~ A * B
    table <- anova(of$fit, M = outer, X = inner, idata = of$cells, test = "Spherical")
    for (row in 1:2) {
      label <- paste0(c("", "Hard:")[row], effect)
      cat(sprintf('{"design": "%s", "effect": "%s", "corrected": [%.12g, %.12g]}\n', name, label, table[row, "F"], table[row, which]))
    }
  }
}
corrected("split_plot_of_two", two, "H-F Pr")
corrected("few_plots_of_two", typed(read("few_plots_of_two")), "G-G Pr")
