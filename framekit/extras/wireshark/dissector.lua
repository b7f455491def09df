-- Wireshark: fields, what is shown of a frame, frames in a stream, and the request that a reply belongs to.

if not Proto then -- not Wireshark: what asks for this file reads frames itself
  return { X = X, F = F, R = R, WANT = WANT, QUIET = QUIET, NOT = NOT }
end

local P = R.protocol
local proto = Proto(P.name, P.about ~= "" and P.label .. ": " .. P.about or P.label)
local MOST_WORK = 2 ^ 20 -- bytes that are read to find the frames of one packet; the rest of it is noise then

-- ---- fields -----------------------------------------------------------------------------------------------------

local KINDS = {
  uint32 = ProtoField.uint32, int32 = ProtoField.int32, uint64 = ProtoField.uint64, int64 = ProtoField.int64,
  double = ProtoField.double, string = ProtoField.string, bytes = ProtoField.bytes,
}
local fields, all_fields = {}, {}

local function field(kind, name, label, ...)
  local made = KINDS[kind](name, label, ...)
  all_fields[#all_fields + 1] = made
  return made
end

for place, one in ipairs(R.fields) do
  if one.kind == "double" then
    fields[place] = field("double", one.filter, one.label, one.doc)
  elseif one.kind == "string" then
    fields[place] = field("string", one.filter, one.label, base.UNICODE, one.doc)
  elseif one.kind == "bytes" then
    fields[place] = field("bytes", one.filter, one.label, base.SPACE, one.doc)
  else
    fields[place] = field(one.kind, one.filter, one.label, base.DEC, one.values, nil, one.doc)
  end
end

local f_frame = field("string", P.name .. ".frame", "Frame")
local f_request = ProtoField.framenum(P.name .. ".request_in", "Request in", base.NONE, frametype.REQUEST)
local f_response = ProtoField.framenum(P.name .. ".response_in", "Response in", base.NONE, frametype.RESPONSE)
local f_time = ProtoField.relative_time(P.name .. ".time", "Time since the request")
for _, one in ipairs({ f_request, f_response, f_time }) do
  all_fields[#all_fields + 1] = one
end
proto.fields = all_fields

local expert_fields = {
  bad = ProtoExpert.new(P.name .. ".expert.bad", "No frame of this protocol", expert.group.MALFORMED, expert.severity.ERROR),
  check = ProtoExpert.new(P.name .. ".expert.check", "Wrong check code", expert.group.CHECKSUM, expert.severity.ERROR),
  refused = ProtoExpert.new(P.name .. ".expert.refused", "A server refuses it", expert.group.PROTOCOL, expert.severity.WARN),
  unverified =
    ProtoExpert.new(P.name .. ".expert.unverified", "Check code not verified", expert.group.CHECKSUM, expert.severity.NOTE),
  unsaid =
    ProtoExpert.new(P.name .. ".expert.unsaid", "This file cannot read it", expert.group.UNDECODED, expert.severity.NOTE),
  noise = ProtoExpert.new(P.name .. ".expert.noise", "Bytes between frames", expert.group.PROTOCOL, expert.severity.WARN),
  part = ProtoExpert.new(P.name .. ".expert.part", "A frame goes on", expert.group.REASSEMBLE, expert.severity.CHAT),
}
local experts = {}
for _, one in pairs(expert_fields) do
  experts[#experts + 1] = one
end
proto.experts = experts

proto.prefs.side = Pref.enum("Sent bytes are those of", 1, "Who sends what a serial capture calls sent (TX)", {
  { 1, "found out", 1 }, { 2, "not looked at", 2 }, { 3, "the client", 3 }, { 4, "the server", 4 },
})
proto.prefs.follows = Pref.bool("Frames tell the state", true, "What a frame announces holds for those behind it")
proto.prefs.pause = Pref.uint("Pause that ends a frame (ms)", 1000, "On a serial line nothing goes on after it")

-- ---- what is shown ----------------------------------------------------------------------------------------------

local function utf8_of(text)
  return (text:gsub("[%z\128-\255]", function(sign)
    local byte = sign:byte()
    if byte == 0 then
      return "\226\144\128" -- a sign for NUL, which would end the text
    end
    return string.char(0xC0 + math.floor(byte / 64), 0x80 + byte % 64)
  end))
end

-- Parameters that frames depend on: those of the file, until a preference says another.
for _, one in ipairs(P.params) do
  local value, about = R.given[one.name], one.doc
  if one.kind == "choice" then
    local rows, chosen = {}, 1
    for place, text in ipairs(one.of) do
      rows[place] = { utf8_of(text), utf8_of(text), place } -- its name is what -o and the profile say
      chosen = text == value and place or chosen
    end
    proto.prefs[one.key] = Pref.enum(one.name, chosen, about, rows)
  elseif one.kind == "flag" then
    proto.prefs[one.key] = Pref.bool(one.name, value == 1, about)
  elseif one.kind == "number" then
    one.made_with = value
    about = string.format("%s (%.0f to %.0f; another number counts as %.0f)", about, one.low, one.high, value)
    proto.prefs[one.key] = Pref.uint(one.name, value, about)
  else
    proto.prefs[one.key] = Pref.string(one.name, utf8_of(value), about)
  end
end

function proto.prefs_changed()
  for _, one in ipairs(P.params) do
    local value = proto.prefs[one.key]
    if one.kind == "choice" then
      value = one.of[value]
    elseif one.kind == "flag" then
      value = value and 1 or 0
    elseif one.kind == "number" and (value < one.low or value > one.high) then
      value = one.made_with
    end
    R.given[one.name] = value
  end
end

-- The two halves of a number of 64 bits; nil for a larger one.
local function halves(value)
  if type(value) == "number" then
    return value % 2 ^ 32, math.floor(value / 2 ^ 32) % 2 ^ 32
  end
  local low, high = 0, 0
  for digit in value.wide:gmatch("%d") do
    low = low * 10 + tonumber(digit)
    high = high * 10 + math.floor(low / 2 ^ 32)
    low = low % 2 ^ 32
  end
  if high >= 2 ^ 32 then
    return nil
  end
  if value.wide:sub(1, 1) == "-" then
    if high > 2 ^ 31 or (high == 2 ^ 31 and low > 0) then
      return nil
    end
    high = (2 ^ 32 - high - (low > 0 and 1 or 0)) % 2 ^ 32
    low = (2 ^ 32 - low) % 2 ^ 32
  end
  return low, high
end

local function add_value(tree, s, value, range, raw)
  local one = R.fields[R.places[s.f]]
  local made = fields[R.places[s.f]]
  local kind = type(value)
  local is_wide = kind == "table" and value.wide
  local fits = (kind == "number" and value == math.floor(value)) or is_wide
  if one.kind == "uint32" and kind == "number" and fits and value >= 0 and value < 2 ^ 32 then
    return tree:add(made, range, value)
  elseif one.kind == "int32" and kind == "number" and fits and value >= -2 ^ 31 and value < 2 ^ 31 then
    return tree:add(made, range, value)
  elseif one.kind == "uint64" and fits and not (kind == "number" and value < 0 or is_wide and is_wide:sub(1, 1) == "-") then
    local low, high = halves(value)
    if low then
      return tree:add(made, range, UInt64.new(low, high))
    end
  elseif one.kind == "int64" and fits then
    local low, high = halves(value)
    if low and (high < 2 ^ 31 or kind == "number" or is_wide:sub(1, 1) == "-") then
      return tree:add(made, range, Int64.new(low, high))
    end
  elseif one.kind == "double" and kind == "number" then
    return tree:add(made, range, value)
  elseif one.kind == "string" and (kind == "string" or kind == "number") then
    return tree:add(made, range, utf8_of(X.shown(value)))
  elseif one.kind == "bytes" and kind == "table" and value.raw then
    if value.raw == raw then
      return tree:add(made, range)
    elseif value.raw ~= "" then -- converted: bytes of their own
      return tree:add(made, ByteArray.new(F.tohex(value.raw)):tvb(one.label)())
    end
  end
  return tree:add(range, utf8_of(s.shown .. ": " .. X.shown(value)))
end

-- What was read, in its order; records and items of lists are branches.
local function add_all(tree, n, raw, tvb, map)
  local branches = { [""] = tree }
  local function branch(path, start)
    local known = branches[path]
    if not known then
      local outer, own = path:match("^(.*%.)([^.]*%.)$")
      own = (own or path):gsub("%.$", "")
      known = branch(outer or "", start):add(tvb(start, 0), utf8_of(own))
      branches[path] = known
    end
    return known
  end
  for _, e in ipairs(n.shown) do
    local function place(at)
      return map(e.places and e.places[math.min(at, #e.places - 1) + 1] or at)
    end
    local first = place(e.first)
    if e.one then
      add_all(e.name and n.last_inner or branch(e.path, first), e.one, raw, tvb, function(at)
        return place(e.first + at)
      end)
    else
      local under = branch(e.path, first)
      local last = math.max(place(e.last), first)
      local function range(a, b)
        return tvb(a, math.max(0, math.min(b, tvb:len()) - a))
      end
      if type(e.value) == "table" and e.value.items and e.s.item_size then
        for index = 1, e.value.items do
          local from, to = place(e.first + (index - 1) * e.s.item_size), place(e.first + index * e.s.item_size)
          add_value(under, e.s, e.value[index], range(from, to), raw:sub(from + 1, to))
        end
        if e.value.items == 0 then
          under:add(range(first, first), utf8_of(e.s.shown .. ": none"))
        end
      else
        local item = add_value(under, e.s, e.value, range(first, last), raw:sub(first + 1, last))
        if e.s.kind == "inner" then
          n.last_inner = item
        end
      end
    end
  end
end

local function fault_text(name, fault)
  local expected = fault.expected ~= "" and ", expected " .. fault.expected or ""
  local found = fault.found ~= "" and ", found " .. fault.found or ""
  return utf8_of(string.format("%s: %s at byte %.0f: %s%s%s", name, fault.segment, fault.place, fault.cause, expected, found))
end

-- One piece of a stream: a frame, a bad one, noise, or the beginning of one that goes on.
local function add_piece(piece, tvb, pinfo, tree, start, raw)
  local from = tvb
  if raw then -- it came in several packets
    from, start = ByteArray.new(F.tohex(raw)):tvb("Frame"), 0
  else
    raw = tvb:raw(start, piece.size)
  end
  local range = from(start, piece.size)
  local item = tree:add(proto, range, P.label)
  local n = piece.n
  if piece.kind == "frame" then
    item:append_text(", " .. utf8_of(n.frame.name))
    item:add(f_frame, range, utf8_of(n.frame.name))
    add_all(item, n, raw, range:tvb(), function(at)
      return at
    end)
    for _, fault in ipairs(n.notes.warnings) do
      item:add_proto_expert_info(expert_fields.check, fault_text(n.frame.name, fault))
    end
    for _, text in ipairs(n.notes.unverified) do
      item:add_proto_expert_info(expert_fields.unverified, utf8_of("Not verified: " .. text))
    end
    if piece.refusal then
      local fault = R.fault_of(n)
      local text = string.format("It is refused with code %.0f", piece.refusal)
      item:add_proto_expert_info(
        expert_fields.refused, fault and text .. ": " .. fault_text(n.frame.name, fault) or text
      )
    end
    return item, n.frame.name
  elseif piece.kind == "bad" then
    local name = piece.near and piece.near.frame.name or "none"
    local fault = piece.near and R.fault_of(piece.near)
    local text = fault and "No frame fits; nearest is " .. fault_text(name, fault) or "No frame fits"
    local is_check = fault and fault.cause == "check"
    item:append_text(is_check and ", wrong check code" or ", no frame")
    item:add_proto_expert_info(is_check and expert_fields.check or expert_fields.bad, text)
    return item, is_check and "wrong check code" or "no frame"
  elseif piece.kind == "unsaid" then
    item:append_text(", not read")
    local text = piece.limited.frame.name .. ": " .. piece.limited.limited
    item:add_proto_expert_info(expert_fields.unsaid, utf8_of("It may be " .. text))
    return item, "not read"
  elseif piece.kind == "noise" then
    item:append_text(", noise")
    item:add_proto_expert_info(expert_fields.noise, string.format("%.0f bytes are of no frame", piece.size))
    return item, "noise"
  end
  item:append_text(", a frame that goes on")
  item:add_proto_expert_info(expert_fields.part, piece.text or "The rest of the frame follows")
  return item, "part of a frame"
end

-- ---- frames in a stream -----------------------------------------------------------------------------------------

local work = 0

-- What begins at a place of some bytes: a piece, or nil and how many bytes are wanted.
--
-- `is_first`: nothing stands before it that is no frame, so that it may be one that silence ends.
local function look(names, raw, start, is_first)
  local want, wrong, refused, other
  for _, name in ipairs(names) do
    local frame = R.frames[name]
    local size, more = NOT, nil
    if R.may_be(frame, raw, start) and work < MOST_WORK then
      work = work + math.min(#raw - start, frame.most or #raw) + 64
      size, more = R.measure(frame, raw, start, #raw)
    end
    if size == QUIET and is_first then
      size = #raw - start
      local n = R.read(frame, raw:sub(start + 1))
      if n.limited then
        return { kind = "unsaid", limited = { frame = frame, limited = n.limited }, size = size }
      elseif not R.fault_of(n) and not n.unknown and not frame.refuse then
        n.frame = frame
        return { kind = "frame", n = n, size = size }
      end
    elseif type(size) == "number" and size > 0 then
      local n = R.read(frame, raw:sub(start + 1, start + size))
      local fault = R.fault_of(n)
      n.frame = frame
      if n.limited then
        return { kind = "unsaid", limited = { frame = frame, limited = n.limited }, size = size }
      elseif not fault and not frame.refuse and not n.unknown then
        return { kind = "frame", n = n, size = size }
      elseif not fault and not frame.refuse then
        other = other or { kind = "frame", n = n, size = size }
      elseif not fault or (fault.refuse and fault.cause ~= "check") then
        refused = refused or { kind = "frame", n = n, size = size, refusal = fault and fault.refuse or frame.refuse }
      elseif not wrong and fault.cause == "check" and not n.notes.first then
        wrong = { kind = "bad", near = n, size = size }
      end
    elseif size == WANT then
      want = math.min(want or more, more)
    end
  end
  if want then
    return nil, want
  end
  return other or refused or wrong
end

-- The pieces of some bytes, and how many more the last one wants, which is not among them.
local function pieces_of(names, raw)
  local n, refusal, limited = R.fit(names, raw)
  if n and not refusal then
    return { { kind = "frame", n = n, size = #raw } }
  end
  local near = not n and refusal or nil
  local found, noise, place = {}, 0, 0
  work = 0
  local function put(piece)
    if noise < place then
      found[#found + 1] = { kind = "noise", size = place - noise }
    end
    found[#found + 1] = piece
  end
  while place < #raw do
    local piece, want = look(names, raw, place, place == noise)
    if place == 0 and n and not piece and not want then
      return { { kind = "frame", n = n, size = #raw, refusal = refusal } }
    end
    if piece and piece.kind == "bad" then -- a good frame may begin in what looks like a bad one
      for inside = place + 1, place + piece.size - 1 do
        local other = look(names, raw, inside, false)
        if other and other.kind == "frame" and not other.refusal then
          piece, place = other, inside
          break
        end
      end
    end
    if piece then
      put(piece)
      place = place + piece.size
      noise = place
    elseif want then
      if noise < place then
        found[#found + 1] = { kind = "noise", size = place - noise }
      end
      return found, want, place
    else
      place = work < MOST_WORK and place + 1 or #raw
    end
  end
  if noise == 0 then -- nothing at all
    if limited then
      return { { kind = "unsaid", limited = limited, size = #raw } }
    end
    return { { kind = "bad", near = near, size = #raw } }
  elseif noise < #raw then
    found[#found + 1] = { kind = "noise", size = #raw - noise }
  end
  return found
end

-- ---- conversations ----------------------------------------------------------------------------------------------

local conversations = {}

function proto.init()
  conversations = {}
end

local function conversation(key)
  conversations[key] = conversations[key] or { requests = {}, links = {}, packets = {}, held = {}, learned = {}, before = {}, state = {} }
  return conversations[key]
end

-- What a frame tells of later ones becomes the state; a state that has been kept is never changed.
local function announce(n)
  if not proto.prefs.follows then
    return
  end
  for _, one in ipairs(n.frame and n.frame.announces or {}) do
    local fine, value = pcall(one[2], n)
    local state = {}
    for name, known in pairs(R.state) do
      state[name] = known
    end
    state[one[1]] = fine and value or { limit = "'" .. one[1] .. "', which an earlier frame has told" }
    R.state = state
  end
  for _, e in ipairs(n.shown) do
    if e.one then
      e.one.frame = R.frames[e.name]
      announce(e.one)
    end
  end
end

local function first_of(n, name)
  local fine, value = pcall(X.of, n, name)
  if fine then
    return value
  end
  for _, e in ipairs(n.shown) do
    if e.one then
      value = first_of(e.one, name)
      if value ~= nil then
        return value
      end
    end
  end
end

-- Whether a reply has what it repeats of a request.
local function repeats(reply, request)
  for _, one in ipairs(reply.frame and reply.frame.echo or {}) do
    local own = first_of(reply, one[1])
    local fine, wanted = pcall(one[2], request)
    if not fine then
      wanted = nil
      for _, e in ipairs(request.shown) do
        if e.one and wanted == nil then
          local inside, value = pcall(one[2], e.one)
          wanted = inside and value or nil
        end
      end
    end
    if own ~= nil and wanted ~= nil and not X.equal(own, wanted) then
      return false
    end
  end
  for _, e in ipairs(reply.shown) do
    if e.one and not repeats(e.one, request) then
      return false
    end
  end
  return true
end

-- Links a reply with its request; `index` tells the frames of one packet apart.
local function link(talk, n, way, pinfo, index)
  local key = pinfo.number .. ":" .. index
  if not pinfo.visited and talk.links[key] == nil then
    local side = n.frame.side
    talk.links[key] = {}
    if side == "client" then
      table.insert(talk.requests, 1, { n = n, way = way, number = pinfo.number, at = pinfo.abs_ts, key = key })
      talk.requests[17] = nil
    elseif side == "server" then
      for place, one in ipairs(talk.requests) do
        if one.way ~= way and repeats(n, one.n) then
          talk.links[key] = { request = one.number, time = pinfo.abs_ts - one.at }
          talk.links[one.key].response = pinfo.number
          table.remove(talk.requests, place)
          break
        end
      end
    end
  end
  return talk.links[key] or {}
end

local function add_link(item, found)
  if found.request then
    item:add(f_request, found.request):set_generated()
    local seconds = math.floor(found.time)
    item:add(f_time, NSTime.new(seconds, math.floor((found.time - seconds) * 1e9 + 0.5))):set_generated()
  end
  if found.response then
    item:add(f_response, found.response):set_generated()
  end
end

local function note_columns(pinfo, names)
  pinfo.cols.protocol = P.label
  pinfo.cols.info = table.concat(names, ", ")
end

local function candidates(side)
  return P[side] or P.any
end

-- ---- TCP, and datagrams, whose frames end in them -----------------------------------------------------------------

local function network(tvb, pinfo, tree, is_stream)
  local server = tostring(pinfo.src) .. ":" .. pinfo.src_port
  local client = tostring(pinfo.dst) .. ":" .. pinfo.dst_port
  local side = "any"
  if pinfo.match_uint == pinfo.src_port then
    side = "server"
  elseif pinfo.match_uint == pinfo.dst_port then
    side = "client"
  end
  local talk = conversation(server < client and server .. " " .. client or client .. " " .. server)
  local mark = pinfo.number .. ":" .. tvb:len()
  talk.before[mark] = talk.before[mark] or talk.state
  R.state = talk.before[mark]
  local raw = tvb:raw()
  local found, want, place = pieces_of(candidates(side), raw)
  local names, at = {}, 0
  for index, piece in ipairs(found) do
    local item, name = add_piece(piece, tvb, pinfo, tree, at)
    names[#names + 1] = name
    if piece.kind == "frame" and not piece.refusal then
      announce(piece.n)
      add_link(item, link(talk, piece.n, side == "any" and server or side, pinfo, index .. ":" .. at))
    end
    at = at + piece.size
  end
  if not pinfo.visited then
    talk.state = R.state
  end
  R.state = {}
  if want and not is_stream then
    local _, near = R.fit(candidates(side), raw:sub(place + 1))
    local _, name = add_piece({ kind = "bad", near = near, size = #raw - place }, tvb, pinfo, tree, place)
    names[#names + 1] = name
  end
  note_columns(pinfo, names)
  if want and is_stream then
    pinfo.desegment_offset = place
    pinfo.desegment_len = DESEGMENT_ONE_MORE_SEGMENT -- `want` is the least that is wanted
  end
  return tvb:len()
end

-- ---- serial lines -----------------------------------------------------------------------------------------------
--
-- Each record of a capture of a serial line has some bytes of one direction, which begin and end anywhere. The record's
-- header is read by Wireshark itself; which direction it has is kept for all dissectors of framekit.

_G.framekit_serial = _G.framekit_serial or {} -- each script has globals of its own, all have this table
local framekit_serial = _G.framekit_serial
if not framekit_serial.proto then
  framekit_serial.proto = Proto("fk_serial", "Serial line, for framekit's dissectors")
  framekit_serial.way, framekit_serial.all = {}, {}
  function framekit_serial.proto.init() -- another file has other packets
    framekit_serial.way = {}
  end
  function framekit_serial.proto.dissector(tvb, pinfo, tree)
    local kind = tvb:len() > 8 and tvb(8, 1):uint() or 0
    framekit_serial.way[pinfo.number] = (kind == 1 or kind == 3) and "out" or "in"
    local header = Dissector.get("rtacser")
    if #framekit_serial.all > 1 or tvb:len() <= 12 then -- Decode As says which of them it is
      return header:call(tvb, pinfo, tree)
    end
    header:call(tvb(0, 12):tvb(), pinfo, tree)
    return framekit_serial.all[1](tvb(12):tvb(), pinfo, tree)
  end
  DissectorTable.get("wtap_encap"):add(wtap.RTAC_SERIAL, framekit_serial.proto)
end

-- Who sends the bytes of a direction, as far as that is known; and the frames that are tried.
local function side_of(talk, way)
  local chosen = proto.prefs.side
  if chosen == 2 then
    return nil
  elseif chosen == 3 or chosen == 4 then
    return (chosen == 3) == (way == "out") and "client" or "server"
  end
  return talk.learned[way]
end

-- The pieces of a direction's bytes; where both sides have such frames, the side that fits what was before.
local function serial_pieces(talk, way, raw)
  local side = side_of(talk, way)
  if side or proto.prefs.side == 2 then
    local found, want, place = pieces_of(candidates(side or "any"), raw)
    local is_good = found[1] and found[1].kind == "frame"
    if is_good or want or proto.prefs.side ~= 1 then
      return found, want, place
    end
  end
  local client, server = R.fit(P.client, raw), R.fit(P.server, raw)
  local other = way == "in" and "out" or "in"
  if client and not server then
    talk.learned[way], talk.learned[other] = "client", "server"
    return pieces_of(P.client, raw)
  elseif server and not client then
    talk.learned[way], talk.learned[other] = "server", "client"
    return pieces_of(P.server, raw)
  elseif client and server and talk.last and talk.last.way == other and talk.last.side == "client" then
    return pieces_of(P.server, raw)
  end
  return pieces_of(P.any, raw)
end

local function serial_packet(talk, way, raw, pinfo)
  local held = talk.held[way]
  if held and pinfo.abs_ts - held.at > proto.prefs.pause / 1000 then
    held.packet.ended = "Nothing came after these bytes in time: the frame is not whole"
    held = nil
  end
  talk.held[way] = nil
  local all = held and held.raw .. raw or raw
  local packet = { pieces = {}, held = held and #held.raw or 0, all = all }
  talk.packets[pinfo.number] = packet
  R.state = talk.state
  local found, want, place = serial_pieces(talk, way, all)
  packet.pieces = found
  if want then
    packet.rest = place
    talk.held[way] = { raw = all:sub(place + 1), at = pinfo.abs_ts, packet = packet }
  end
  for index, piece in ipairs(found) do
    if piece.kind == "frame" then
      talk.last = { way = way, side = piece.n.frame.side }
      if not piece.refusal then
        announce(piece.n)
        link(talk, piece.n, way, pinfo, index)
      end
    end
  end
  talk.state, R.state = R.state, {}
  if held then
    held.packet.goes_on = pinfo.number
  end
  return packet
end

local function serial(tvb, pinfo, tree, way)
  local talk = conversation("serial")
  local packet = talk.packets[pinfo.number]
  if not packet then
    packet = serial_packet(talk, way, tvb:raw(), pinfo)
  end
  local at, names = -packet.held, {}
  for index, piece in ipairs(packet.pieces) do
    local raw = at < 0 and packet.all:sub(at + packet.held + 1, at + packet.held + piece.size) or nil
    local item, name = add_piece(piece, tvb, pinfo, tree, at, raw)
    names[#names + 1] = name
    if piece.kind == "frame" then
      add_link(item, talk.links[pinfo.number .. ":" .. index] or {})
    end
    at = at + piece.size
  end
  if packet.rest then
    local start = math.max(0, packet.rest - packet.held)
    local text = packet.ended or packet.goes_on and "The frame goes on in packet " .. string.format("%.0f", packet.goes_on)
    local piece = { kind = "part", size = tvb:len() - start, text = text }
    if packet.ended then
      local n, other = R.fit(P.any, packet.all:sub(packet.rest + 1))
      if n then
        piece = { kind = "frame", n = n, size = piece.size, refusal = other }
      else
        piece = { kind = "bad", near = other, size = piece.size }
      end
    end
    local _, name = add_piece(piece, tvb, pinfo, tree, start)
    names[#names + 1] = name
  end
  note_columns(pinfo, names)
  return tvb:len()
end

function proto.dissector(tvb, pinfo, tree)
  if tvb:len() == 0 then
    return 0
  end
  local way = framekit_serial.way[pinfo.number]
  if way then
    return serial(tvb, pinfo, tree, way)
  end
  return network(tvb, pinfo, tree, pinfo.port_type == 2) -- that of TCP
end

table.insert(framekit_serial.all, proto.dissector)
DissectorTable.get("rtacser.data"):add_for_decode_as(proto)
if P.tcp then
  DissectorTable.get("tcp.port"):add(P.tcp, proto)
else
  DissectorTable.get("tcp.port"):add_for_decode_as(proto)
end
DissectorTable.get("udp.port"):add_for_decode_as(proto)
