// SPDX-License-Identifier: BSD-3-Clause
#include "core_perception/param_reader.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "core_perception/exceptions.h"

namespace core_perception {
namespace {

using Kind = ParamValue::Kind;

std::string formatBounds(const std::string& what, const Bounds& bounds) {
  std::ostringstream out;
  out << what << " in [" << bounds.lowest << ", " << bounds.highest << "]";
  return out.str();
}

double checkNumber(const std::string& key, const ParamValue& value, const Bounds& bounds) {
  const bool numeric = value.kind == Kind::kInt || value.kind == Kind::kDouble;
  const bool inside = numeric && std::isfinite(value.number) && value.number >= bounds.lowest &&
                      value.number <= bounds.highest;
  if (!inside) throw ParameterError(key, value.toText(), formatBounds("a number", bounds));
  return value.number;
}

std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

}  // namespace

ParamValue ParamValue::ofBool(bool value) {
  ParamValue result;
  result.kind = Kind::kBool;
  result.flag = value;
  return result;
}

ParamValue ParamValue::ofInt(int value) {
  ParamValue result;
  result.kind = Kind::kInt;
  result.number = value;
  return result;
}

ParamValue ParamValue::ofDouble(double value) {
  ParamValue result;
  result.kind = Kind::kDouble;
  result.number = value;
  return result;
}

ParamValue ParamValue::ofString(const std::string& value) {
  ParamValue result;
  result.kind = Kind::kString;
  result.text = value;
  return result;
}

std::string ParamValue::toText() const {
  std::ostringstream out;
  switch (kind) {
    case Kind::kBool:
      out << (flag ? "true" : "false");
      break;
    case Kind::kInt:
    case Kind::kDouble:
      out << number;
      break;
    case Kind::kString:
      out << '"' << text << '"';
      break;
    case Kind::kList:
      out << "a list of " << list.size();
      break;
    case Kind::kStruct:
      out << "a table of " << members.size();
      break;
    case Kind::kOther:
      out << "a value of another type";
      break;
  }
  return out.str();
}

const ParamValue* ParamReader::find(const std::string& key) {
  known_.insert(key);
  const auto it = values_.find(key);
  return it == values_.end() ? nullptr : &it->second;
}

void ParamReader::read(const std::string& key, double* field, const Bounds& bounds) {
  if (const ParamValue* value = find(key)) *field = checkNumber(key, *value, bounds);
}

void ParamReader::read(const std::string& key, int* field, const Bounds& bounds) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  if (value->kind != Kind::kInt)
    throw ParameterError(key, value->toText(), formatBounds("a whole number", bounds));
  *field = static_cast<int>(checkNumber(key, *value, bounds));
}

void ParamReader::read(const std::string& key, bool* field) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  if (value->kind != Kind::kBool) throw ParameterError(key, value->toText(), "true or false");
  *field = value->flag;
}

void ParamReader::read(const std::string& key, std::string* field,
                       const std::vector<std::string>& allowed) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  const bool listed =
      allowed.empty() || std::count(allowed.begin(), allowed.end(), value->text) > 0;
  if (value->kind != Kind::kString || value->text.empty() || !listed) {
    throw ParameterError(key, value->toText(),
                         allowed.empty() ? "a non-empty text" : "one of " + join(allowed));
  }
  *field = value->text;
}

void ParamReader::readText(const std::string& key, std::string* field) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  if (value->kind != Kind::kString) throw ParameterError(key, value->toText(), "a text");
  *field = value->text;
}

void ParamReader::read(const std::string& key, std::vector<std::string>* field) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  if (value->kind != Kind::kList) throw ParameterError(key, value->toText(), "a list of texts");
  field->clear();
  for (const ParamValue& item : value->list) {
    if (item.kind != Kind::kString || item.text.empty()) {
      throw ParameterError(key, item.toText() + " in the list", "non-empty texts");
    }
    field->push_back(item.text);
  }
}

void ParamReader::read(const std::string& key, std::map<std::string, double>* field,
                       const Bounds& bounds) {
  const ParamValue* value = find(key);
  if (value == nullptr) return;
  if (value->kind != Kind::kStruct)
    throw ParameterError(key, value->toText(), "a table from name to number");
  field->clear();
  for (const auto& member : value->members) {
    (*field)[member.first] = checkNumber(key + "/" + member.first, member.second, bounds);
  }
}

void ParamReader::finish() const {
  for (const auto& entry : values_) {
    if (known_.count(entry.first) > 0) continue;
    throw ParameterError(entry.first, entry.second.toText(),
                         "only " + join(std::vector<std::string>(known_.begin(), known_.end())));
  }
}

}  // namespace core_perception
