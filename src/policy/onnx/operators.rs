//! The operators of policy networks, as ONNX's operator sets 7 to 22 define them.
//!
//! No output's shape depends on single-precision values, only on shapes, attributes and constants: a graph that was
//! evaluated once can be evaluated with any other observation.

use super::arithmetic::{
    along, axis, broadcast, broadcast_indices, erf, fits, matrix, multiply, positions, sigmoid, softplus,
};
use super::proto::{Attribute, BFLOAT16, DOUBLE, FLOAT, FLOAT16, INT32, INT64, Node};
use super::tensor::{Tensor, Values, elements, strides};
use super::{Result, Unsupported};

/// Names of all supported operators, for error messages.
pub const KNOWN: &str = "Abs Add BatchNormalization Cast Celu Clip Concat Constant Div Dropout Elu Erf Exp Expand Flatten \
                         Gather Gelu Gemm HardSigmoid HardSwish Identity LayerNormalization LeakyRelu Log MatMul Max Min \
                         Mish Mul Neg PRelu Pow Reciprocal ReduceL2 ReduceMean ReduceSum Relu Reshape Selu Shape Sigmoid \
                         Slice Softplus Softsign Split Sqrt Squeeze Sub Tanh Transpose Unsqueeze";

/// A node with the values of its inputs; `None` for an omitted input.
pub struct OperatorCall<'a> {
    /// The operator and its attributes.
    pub node: &'a Node,
    /// The inputs in the operator's order.
    pub inputs: &'a [Option<&'a Tensor>],
}

impl OperatorCall<'_> {
    /// Runs the operator and returns its outputs.
    pub fn evaluate(&self) -> Result<Vec<Tensor>> {
        let domain = self.node.domain.as_str();
        if !matches!(domain, "" | "ai.onnx") {
            return Err(format!("its operator is of the domain '{domain}'; only ONNX's own are supported").into());
        }
        let one = match self.node.op_type.as_str() {
            "Identity" | "Dropout" => self.input(0)?.clone(),
            "Constant" => self.constant()?,
            "Cast" => self.cast()?,
            "Abs" => self.input(0)?.map(f32::abs)?,
            "Neg" => self.input(0)?.map(|x| -x)?,
            "Exp" => self.input(0)?.map(f32::exp)?,
            "Log" => self.input(0)?.map(f32::ln)?,
            "Sqrt" => self.input(0)?.map(f32::sqrt)?,
            "Reciprocal" => self.input(0)?.map(|x| 1.0 / x)?,
            "Relu" => self.input(0)?.map(|x| propagating(x, 0.0, f32::max))?,
            "Tanh" => self.input(0)?.map(f32::tanh)?,
            "Sigmoid" => self.input(0)?.map(sigmoid)?,
            "Softplus" => self.input(0)?.map(softplus)?,
            "Softsign" => self.input(0)?.map(|x| x / (1.0 + x.abs()))?,
            "Mish" => self.input(0)?.map(|x| x * softplus(x).tanh())?,
            "HardSwish" => self.input(0)?.map(|x| x * (x / 6.0 + 0.5).clamp(0.0, 1.0))?,
            "Gelu" => self.gelu()?,
            "Celu" => {
                let alpha = self.float("alpha", 1.0);
                self.input(0)?.map(|x| if x < 0.0 { alpha * (x / alpha).exp_m1() } else { x })?
            }
            "PRelu" => broadcast(self.input(0)?, self.input(1)?, |x, slope| if x < 0.0 { slope * x } else { x })?,
            "Erf" => self.input(0)?.map(erf)?,
            "Elu" => {
                let alpha = self.float("alpha", 1.0);
                self.input(0)?.map(|x| if x < 0.0 { alpha * x.exp_m1() } else { x })?
            }
            "Selu" => {
                let (alpha, gamma) = (self.float("alpha", 1.673_263_2), self.float("gamma", 1.050_701));
                self.input(0)?.map(|x| gamma * if x < 0.0 { alpha * x.exp_m1() } else { x })?
            }
            "LeakyRelu" => {
                let alpha = self.float("alpha", 0.01);
                self.input(0)?.map(|x| if x < 0.0 { alpha * x } else { x })?
            }
            "HardSigmoid" => {
                let (alpha, beta) = (self.float("alpha", 0.2), self.float("beta", 0.5));
                self.input(0)?.map(|x| (alpha * x + beta).clamp(0.0, 1.0))?
            }
            "Add" => self.arithmetic(|a, b| a + b, i64::checked_add)?,
            "Sub" => self.arithmetic(|a, b| a - b, i64::checked_sub)?,
            "Mul" => self.arithmetic(|a, b| a * b, i64::checked_mul)?,
            "Div" => self.arithmetic(|a, b| a / b, i64::checked_div)?,
            "Pow" => broadcast(self.input(0)?, self.input(1)?, f32::powf)?,
            "Max" => self.fold(|a, b| propagating(a, b, f32::max))?,
            "Min" => self.fold(|a, b| propagating(a, b, f32::min))?,
            "Clip" => self.clip()?,
            "ReduceSum" => self.reduce(|values| values.iter().sum())?,
            "ReduceMean" => self.reduce(|values| values.iter().sum::<f32>() / values.len() as f32)?,
            "ReduceL2" => self.reduce(|values| values.iter().map(|value| value * value).sum::<f32>().sqrt())?,
            "Gemm" => self.gemm()?,
            "MatMul" => self.matmul()?,
            "BatchNormalization" => self.batch_normalization()?,
            "LayerNormalization" => self.layer_normalization()?,
            "Shape" => {
                let shape: Vec<i64> = self.input(0)?.shape().iter().map(|size| *size as i64).collect();
                Tensor::int(vec![shape.len()], shape)?
            }
            "Reshape" => self.reshape()?,
            "Expand" => self.expand()?,
            "Flatten" => self.flatten()?,
            "Squeeze" => self.squeeze()?,
            "Unsqueeze" => self.unsqueeze()?,
            "Transpose" => self.transpose()?,
            "Concat" => self.concat()?,
            "Gather" => self.gather()?,
            "Slice" => self.slice()?,
            "Split" => return self.split(),
            other => return Err(format!("the operator {other} is not supported; these are: {KNOWN}").into()),
        };
        Ok(vec![one])
    }

    fn input(&self, index: usize) -> Result<&Tensor> {
        self.optional(index).ok_or_else(|| format!("it has no input {index}").into())
    }

    fn optional(&self, index: usize) -> Option<&Tensor> {
        self.inputs.get(index).copied().flatten()
    }

    fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    fn float(&self, name: &str, default: f32) -> f32 {
        self.attribute(name).map_or(default, |attribute| attribute.f)
    }

    fn int(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).map_or(default, |attribute| attribute.i)
    }

    /// Reads integers from input `index` (newer operator sets) or from an attribute (older ones).
    fn ints(&self, index: usize, name: &str) -> Result<Option<Vec<i64>>> {
        match (self.optional(index), self.attribute(name)) {
            (Some(tensor), _) => Ok(Some(tensor.ints()?.to_vec())),
            (None, Some(attribute)) => Ok(Some(attribute.ints.clone())),
            (None, None) => Ok(None),
        }
    }

    fn constant(&self) -> Result<Tensor> {
        let attribute = self.node.attribute.first().ok_or("it has no value")?;
        match (attribute.name.as_str(), &attribute.t) {
            ("value", Some(tensor)) => Tensor::read(tensor),
            ("value_float", _) => Tensor::float(Vec::new(), vec![attribute.f]),
            ("value_floats", _) => Tensor::float(vec![attribute.floats.len()], attribute.floats.clone()),
            ("value_int", _) => Tensor::int(Vec::new(), vec![attribute.i]),
            ("value_ints", _) => Tensor::int(vec![attribute.ints.len()], attribute.ints.clone()),
            (other, _) => Err(format!("its value is given as '{other}', which is not supported").into()),
        }
    }

    fn cast(&self) -> Result<Tensor> {
        let (tensor, to) = (self.input(0)?, self.int("to", 0) as i32);
        let values = match (tensor.values(), to) {
            // All floating-point numbers are single precision here.
            (Values::Float(_), FLOAT | DOUBLE | FLOAT16 | BFLOAT16) | (Values::Int(_), INT32 | INT64) => {
                tensor.values().clone()
            }
            (Values::Int(values), FLOAT | DOUBLE | FLOAT16 | BFLOAT16) => {
                Values::Float(values.iter().map(|value| *value as f32).collect())
            }
            (Values::Float(_), INT32 | INT64) => {
                return Err("it converts numbers to integers, on which a policy's shapes must not depend".into());
            }
            _ => return Err(format!("it casts to the element type {to}, which is not supported").into()),
        };
        Tensor::new(tensor.shape().to_vec(), values)
    }

    fn arithmetic(&self, float: impl Fn(f32, f32) -> f32, int: impl Fn(i64, i64) -> Option<i64>) -> Result<Tensor> {
        let (a, b) = (self.input(0)?, self.input(1)?);
        let (Values::Int(left), Values::Int(right)) = (a.values(), b.values()) else {
            return broadcast(a, b, float);
        };
        // Arithmetic on shapes.
        let (shape, indices) = broadcast_indices(a.shape(), b.shape())?;
        let result: Option<Vec<i64>> = indices.map(|(i, j)| int(left[i], right[j])).collect();
        Tensor::int(shape, result.ok_or("its integers overflow, or one is divided by zero")?)
    }

    fn fold(&self, function: impl Fn(f32, f32) -> f32 + Copy) -> Result<Tensor> {
        let first = self.input(0)?.clone();
        (1..self.inputs.len()).try_fold(first, |sum, index| broadcast(&sum, self.input(index)?, function))
    }

    fn clip(&self) -> Result<Tensor> {
        let limit = |index: usize, name: &str, default: f32| match self.optional(index) {
            Some(tensor) => match tensor.floats()? {
                [limit] => Ok(*limit),
                other => Err(Unsupported(format!("its limit has {} values, expected one", other.len()))),
            },
            None => Ok(self.float(name, default)),
        };
        let (low, high) = (limit(1, "min", f32::NEG_INFINITY)?, limit(2, "max", f32::INFINITY)?);
        // Not `clamp`, which panics where low > high; ONNX lets the upper limit win.
        self.input(0)?.map(|x| if x.is_nan() { x } else { x.max(low).min(high) })
    }

    fn gelu(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        match self
            .attribute("approximate")
            .map_or("none".into(), |attribute| String::from_utf8_lossy(&attribute.s))
            .as_ref()
        {
            "tanh" => {
                let slope = (2.0 / std::f32::consts::PI).sqrt();
                x.map(|x| 0.5 * x * (1.0 + (slope * (x + 0.044_715 * x.powi(3))).tanh()))
            }
            "none" => x.map(|x| 0.5 * x * (1.0 + erf(x * std::f32::consts::FRAC_1_SQRT_2))),
            other => Err(format!("its approximation is '{other}', expected 'none' or 'tanh'").into()),
        }
    }

    /// Applies a function to the values along some axes; if none are named, along all, or to each value alone on request.
    fn reduce(&self, function: impl Fn(&[f32]) -> f32) -> Result<Tensor> {
        let x = self.input(0)?;
        let rank = x.shape().len();
        let named = self.ints(1, "axes")?.unwrap_or_default();
        let axes = named.iter().map(|index| axis(*index, rank)).collect::<Result<Vec<_>>>()?;
        let are_all = axes.is_empty() && self.int("noop_with_empty_axes", 0) == 0;
        let is_reduced = |index: &usize| are_all || axes.contains(index);
        let (reduced, kept): (Vec<usize>, Vec<usize>) = (0..rank).partition(is_reduced);
        let width = reduced.iter().map(|index| x.shape()[*index]).product();
        ensure!(width > 0, "it reduces no values at all");
        let sorted = permuted(x, &[kept.clone(), reduced].concat())?;
        let values = sorted.floats()?.chunks(width).map(function).collect();
        let shape = if self.int("keepdims", 1) != 0 {
            (0..rank).map(|index| if is_reduced(&index) { 1 } else { x.shape()[index] }).collect()
        } else {
            kept.iter().map(|index| x.shape()[*index]).collect()
        };
        Tensor::float(shape, values)
    }

    /// Computes `alpha · A' · B' + beta · C`.
    fn gemm(&self) -> Result<Tensor> {
        let product = multiply(
            &matrix(self.input(0)?, self.int("transA", 0) != 0)?,
            // The other way round than A: rows of B' transposed are what is multiplied.
            &matrix(self.input(1)?, self.int("transB", 0) == 0)?,
        )?;
        let (alpha, beta) = (self.float("alpha", 1.0), self.float("beta", 1.0));
        let scaled = if alpha == 1.0 { product } else { product.map(|x| alpha * x)? };
        match self.optional(2) {
            Some(offset) => {
                let sum = broadcast(&scaled, offset, |x, c| x + beta * c)?;
                fits(&sum, &scaled)
            }
            None => Ok(scaled),
        }
    }

    fn matmul(&self) -> Result<Tensor> {
        let (a, b) = (self.input(0)?, self.input(1)?);
        let [.., rows, inner] = *a.shape() else {
            let row = a.reshaped(vec![1, a.shape().iter().product()])?;
            let product = multiply(&row, &matrix(b, true)?)?;
            return product.reshaped(product.shape()[1..].to_vec());
        };
        // Dimensions before the last two are more rows.
        let batch = a.shape()[..a.shape().len() - 2].iter().product::<usize>();
        let product = multiply(&a.reshaped(vec![batch * rows, inner])?, &matrix(b, true)?)?;
        let mut shape = a.shape().to_vec();
        shape.pop();
        shape.extend(product.shape().last());
        product.reshaped(shape)
    }

    fn batch_normalization(&self) -> Result<Tensor> {
        ensure!(self.int("training_mode", 0) == 0, "it is in training mode: export the network in evaluation mode");
        let x = self.input(0)?;
        let [scale, bias, mean, variance] = [1, 2, 3, 4].map(|index| self.input(index));
        let (scale, bias, mean, variance) = (scale?, bias?, mean?, variance?);
        ensure!(x.shape().len() == 2, "its input has the shape {:?}, expected two dimensions", x.shape());
        let epsilon = self.float("epsilon", 1e-5);
        let deviation = variance.map(|value| (value + epsilon).sqrt())?;
        let centred = broadcast(x, mean, |x, mean| x - mean)?;
        let normal = broadcast(&centred, &deviation, |x, deviation| x / deviation)?;
        let scaled = broadcast(&normal, scale, |x, scale| x * scale)?;
        fits(&broadcast(&scaled, bias, |x, bias| x + bias)?, x)
    }

    fn layer_normalization(&self) -> Result<Tensor> {
        let (x, epsilon) = (self.input(0)?, self.float("epsilon", 1e-5));
        let width = x.shape().last().copied().unwrap_or(0).max(1);
        if axis(self.int("axis", -1), x.shape().len())? + 1 != x.shape().len() {
            return Err("only the last axis can be normalised".into());
        }
        let normal = x.floats()?.chunks(width).flat_map(|row| {
            let mean = row.iter().sum::<f32>() / width as f32;
            let variance = row.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / width as f32;
            let deviation = (variance + epsilon).sqrt();
            row.iter().map(move |value| (value - mean) / deviation)
        });
        let normal = Tensor::float(x.shape().to_vec(), normal.collect())?;
        let scaled = broadcast(&normal, self.input(1)?, |x, scale| x * scale)?;
        let whole = match self.optional(2) {
            Some(bias) => broadcast(&scaled, bias, |x, bias| x + bias)?,
            None => scaled,
        };
        fits(&whole, x)
    }

    fn reshape(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let wanted = self.ints(1, "shape")?.ok_or("it has no shape")?;
        let keep_zero = self.int("allowzero", 0) == 0;
        let mut shape = Vec::with_capacity(wanted.len());
        for (index, size) in wanted.iter().enumerate() {
            shape.push(match size {
                0 if keep_zero => *x.shape().get(index).ok_or("its shape has a 0 beyond the input's dimensions")?,
                -1 => 1,
                size => usize::try_from(*size).map_err(|_| format!("its shape is {wanted:?}"))?,
            });
        }
        if let Some(open) = wanted.iter().position(|size| *size == -1) {
            let rest = elements(&shape)?.max(1);
            shape[open] = elements(x.shape())? / rest;
        }
        x.reshaped(shape)
    }

    /// Repeats dimensions of size one until the input has a shape.
    fn expand(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let wanted = self.ints(1, "shape")?.ok_or("it has no shape")?;
        let sizes: Option<Vec<usize>> = wanted.iter().map(|size| usize::try_from(*size).ok()).collect();
        let sizes = sizes.ok_or_else(|| format!("its shape is {wanted:?}"))?;
        elements(&sizes)?;
        let (shape, indices) = broadcast_indices(x.shape(), &sizes)?;
        let indices: Vec<usize> = indices.map(|(index, _)| index).collect();
        x.pick(shape, &indices)
    }

    fn flatten(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let at = match self.int("axis", 1) {
            all if all == x.shape().len() as i64 => x.shape().len(),
            other => axis(other, x.shape().len())?,
        };
        let (rows, columns) = x.shape().split_at(at);
        x.reshaped(vec![rows.iter().product(), columns.iter().product()])
    }

    fn squeeze(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let rank = x.shape().len();
        let axes = match self.ints(1, "axes")? {
            Some(axes) => axes.iter().map(|index| axis(*index, rank)).collect::<Result<Vec<_>>>()?,
            None => (0..rank).filter(|index| x.shape()[*index] == 1).collect(),
        };
        let kept = x.shape().iter().enumerate().filter(|(index, _)| !axes.contains(index));
        x.reshaped(kept.map(|(_, size)| *size).collect())
    }

    fn unsqueeze(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let axes = self.ints(1, "axes")?.ok_or("it has no axes")?;
        let rank = x.shape().len() + axes.len();
        let axes = axes.iter().map(|index| axis(*index, rank)).collect::<Result<Vec<_>>>()?;
        let mut sizes = x.shape().iter();
        let shape = (0..rank).map(|index| if axes.contains(&index) { Some(1) } else { sizes.next().copied() });
        x.reshaped(shape.collect::<Option<_>>().ok_or("its axes repeat")?)
    }

    fn transpose(&self) -> Result<Tensor> {
        let x = self.input(0)?;
        let rank = x.shape().len();
        let order: Vec<usize> = match self.attribute("perm") {
            Some(order) => order.ints.iter().map(|index| axis(*index, rank)).collect::<Result<_>>()?,
            None => (0..rank).rev().collect(),
        };
        if !(0..rank).all(|index| order.contains(&index)) || order.len() != rank {
            return Err(format!("its order is {order:?}, expected each of {rank} dimensions once").into());
        }
        permuted(x, &order)
    }

    fn concat(&self) -> Result<Tensor> {
        let first = self.input(0)?;
        let at = axis(self.int("axis", 0), first.shape().len())?;
        let outer: usize = first.shape()[..at].iter().product();
        let parts = (0..self.inputs.len()).map(|index| self.input(index)).collect::<Result<Vec<_>>>()?;
        let mut shape = first.shape().to_vec();
        shape[at] = 0;
        for part in &parts {
            let mut rest = part.shape().to_vec();
            let size = rest.get_mut(at).map(std::mem::take);
            let mut expected = shape.clone();
            expected[at] = 0;
            ensure!(rest == expected, "its inputs have the shapes {:?} and {:?}", first.shape(), part.shape());
            shape[at] += size.unwrap_or(0);
        }
        elements(&shape)?;
        fn join<T: Copy>(outer: usize, parts: &[&[T]]) -> Vec<T> {
            let row = |index: usize, part: &[T]| {
                let width = part.len() / outer.max(1);
                part[index * width..(index + 1) * width].to_vec()
            };
            (0..outer)
                .flat_map(|index| parts.iter().flat_map(move |part| row(index, part)).collect::<Vec<_>>())
                .collect()
        }
        match first.values() {
            Values::Float(_) => {
                let parts = parts.iter().map(|part| part.floats()).collect::<Result<Vec<_>>>()?;
                Tensor::float(shape, join(outer, &parts))
            }
            Values::Int(_) => {
                let parts = parts.iter().map(|part| part.ints()).collect::<Result<Vec<_>>>()?;
                Tensor::int(shape, join(outer, &parts))
            }
        }
    }

    fn gather(&self) -> Result<Tensor> {
        let (x, chosen) = (self.input(0)?, self.input(1)?);
        let at = axis(self.int("axis", 0), x.shape().len())?;
        let size = x.shape()[at];
        let index =
            |index: &i64| axis(*index, size).map_err(|_| format!("its index {index} is beyond {size} values").into());
        let chosen_indices = chosen.ints()?.iter().map(index).collect::<Result<Vec<_>>>()?;
        let mut shape = x.shape()[..at].to_vec();
        shape.extend(chosen.shape());
        shape.extend(&x.shape()[at + 1..]);
        elements(&shape)?;
        along(x, at, &chosen_indices)?.reshaped(shape)
    }

    fn slice(&self) -> Result<Tensor> {
        let starts = self.ints(1, "starts")?.ok_or("it has no starts")?;
        let ends = self.ints(2, "ends")?.ok_or("it has no ends")?;
        let axes = self.ints(3, "axes")?.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = self.ints(4, "steps")?.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()].iter().any(|length| *length != starts.len()) {
            return Err("its starts, ends, axes and steps differ in number".into());
        }
        let mut x = self.input(0)?.clone();
        for (((start, end), index), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
            let at = axis(*index, x.shape().len())?;
            let size = x.shape()[at] as i64;
            let from_end = |value: i64| if value < 0 { value.saturating_add(size) } else { value };
            let chosen: Vec<usize> = match *step {
                0 => return Err("its step is 0".into()),
                step if step > 0 => {
                    let range = from_end(*start).clamp(0, size)..from_end(*end).clamp(0, size);
                    range.step_by(usize::try_from(step).unwrap_or(usize::MAX)).map(|index| index as usize).collect()
                }
                step => {
                    let (first, last) = (from_end(*start).clamp(-1, size - 1), from_end(*end).clamp(-1, size - 1));
                    let down = (last + 1..=first).rev().step_by(step.unsigned_abs() as usize);
                    down.map(|index| index as usize).collect()
                }
            };
            x = along(&x, at, &chosen)?;
        }
        Ok(x)
    }

    fn split(&self) -> Result<Vec<Tensor>> {
        let x = self.input(0)?;
        let at = axis(self.int("axis", 0), x.shape().len())?;
        let (size, parts) = (x.shape()[at], self.node.output.len().max(1));
        let sizes: Vec<usize> = match self.ints(1, "split")? {
            Some(sizes) => sizes.iter().map(|size| usize::try_from(*size).unwrap_or(usize::MAX)).collect(),
            None => {
                let each = size.div_ceil(parts);
                (0..parts).map(|part| each.min(size.saturating_sub(part * each))).collect()
            }
        };
        let total = sizes.iter().try_fold(0_usize, |sum, part| sum.checked_add(*part));
        if total != Some(size) || sizes.len() != parts {
            return Err(format!("it splits {size} values into {sizes:?}, for {parts} outputs").into());
        }
        let mut start = 0;
        let mut part = |length: usize| {
            let chosen: Vec<usize> = (start..start + length).collect();
            start += length;
            along(x, at, &chosen)
        };
        sizes.into_iter().map(&mut part).collect()
    }
}

/// Returns a tensor with its dimensions in another order.
fn permuted(x: &Tensor, order: &[usize]) -> Result<Tensor> {
    let (own, shape) = (strides(x.shape()), order.iter().map(|index| x.shape()[*index]).collect::<Vec<_>>());
    let steps: Vec<usize> = order.iter().map(|index| own[*index]).collect();
    let indices: Vec<usize> = positions(&shape).map(|at| at.iter().zip(&steps).map(|(p, s)| p * s).sum()).collect();
    x.pick(shape, &indices)
}

/// Chooses one of two numbers, or NaN if one of them is NaN, which Rust's own functions ignore.
fn propagating(a: f32, b: f32, choose: fn(f32, f32) -> f32) -> f32 {
    if a.is_nan() || b.is_nan() { f32::NAN } else { choose(a, b) }
}
