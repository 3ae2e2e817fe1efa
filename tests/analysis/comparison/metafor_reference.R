# Prints, as one line of JSON a data set, what the R package metafor finds in data of its package metadat.
suppressMessages(library(metafor))

sets <- list(
  hine1989 = escalc(measure = "RD", n1i = n1i, n2i = n2i, ai = ai, ci = ci, data = dat.hine1989),
  normand1999 = escalc(measure = "MD", m1i = m1i, sd1i = sd1i, n1i = n1i, m2i = m2i, sd2i = sd2i, n2i = n2i, data = dat.normand1999),
  bcg = escalc(measure = "RR", ai = tpos, bi = tneg, ci = cpos, di = cneg, data = dat.bcg),
  molloy2014 = escalc(measure = "ZCOR", ri = ri, ni = ni, data = dat.molloy2014),
  raudenbush1985 = dat.raudenbush1985,
  normand1999_3 = escalc(measure = "MD", m1i = m1i, sd1i = sd1i, n1i = n1i, m2i = m2i, sd2i = sd2i, n2i = n2i, data = dat.normand1999)[1:3, ],
  bcg_2 = escalc(measure = "RR", ai = tpos, bi = tneg, ci = cpos, di = cneg, data = dat.bcg)[4:5, ]
)

shown <- function(values) paste0("[", paste(format(as.numeric(values), digits = 15, scientific = TRUE, trim = TRUE), collapse = ", "), "]")

for (name in names(sets)) {
  found <- sets[[name]]
  random <- rma(yi, vi, data = found, method = "PM", test = "knha", control = list(tol = 1e-12, maxiter = 1000))
  wald <- rma(yi, vi, data = found, method = "PM", control = list(tol = 1e-12, maxiter = 1000))
  common <- rma(yi, vi, data = found, method = "FE")
  profile <- suppressWarnings(confint(random, control = list(tol = 1e-12, tau2.max = 1e7))$random)
  k <- random$k
  # Higgins et al. 2009, by metafor's own estimates.
  reach <- if (k > 2) qt(0.975, k - 2) * sqrt(wald$tau2 + wald$se^2) else NA
  values <- list(
    yi = found$yi, vi = found$vi,
    common = c(common$beta, common$se, common$ci.lb, common$ci.ub, common$pval),
    random = c(random$beta, random$se, random$ci.lb, random$ci.ub, random$pval),
    heterogeneity = c(random$QE, random$QEp, random$tau2, random$I2),
    profile = c(profile["tau^2", 2:3], profile["I^2(%)", 2:3]),
    weights = weights(wald) / 100
  )
  if (k > 2) values$prediction <- c(random$beta - reach, random$beta + reach)
  fields <- sapply(names(values), function(each) sprintf("\"%s\": %s", each, shown(values[[each]])))
  cat(sprintf("{\"name\": \"%s\", %s}\n", name, paste(fields, collapse = ", ")))
}
